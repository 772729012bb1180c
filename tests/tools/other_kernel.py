"""The numerics with another kernel of OpenBLAS than the usual one: its sums round differently.

    python -m tests.tools.other_kernel          # what is fast
    python -m tests.tools.other_kernel --slow   # what is not
"""

import os
import subprocess
import sys
from pathlib import Path

NEEDS = {"SkylakeX": "avx512vl", "Haswell": "fma"}
"""Kernels, and what a processor has that runs them."""
TESTS = ("numerics", "likelihood", "fitting/test_minimum.py", "fitting/test_mle.py", "fitting/test_admissibility.py",
         "change/test_detect.py")
TIERS = {False: "not slow and not study", True: "slow and not study"}
RUNNING = ("import numpy, scipy.linalg, threadpoolctl\n"
           "print(*{each['architecture'] for each in threadpoolctl.threadpool_info() if 'architecture' in each})")


def running(kernel: str | None = None) -> set[str]:
    """Kernels that NumPy and SciPy run, by default or told to take `kernel`."""
    environment = os.environ | ({"OPENBLAS_CORETYPE": kernel} if kernel else {})
    told = subprocess.run([sys.executable, "-c", RUNNING], env=environment, capture_output=True, text=True, check=True)
    return set(told.stdout.split())


def other_kernel(flags: set[str]) -> str | None:
    """A kernel that is not the usual one, on a processor with `flags`; None where there is none."""
    usual = running()
    able = [kernel for kernel, flag in NEEDS.items() if flag in flags and kernel not in usual]
    return next((kernel for kernel in able if running(kernel) == {kernel}), None)


def main() -> int:
    """Run the tests; 0 where there is no other kernel."""
    cpu = Path("/proc/cpuinfo")
    kernel = other_kernel(set(cpu.read_text().split()) if cpu.exists() else set())
    if kernel is None:
        print(f"numerics under one BLAS kernel: this processor has no other of {' and '.join(NEEDS)}", flush=True)
        return 0
    print(f"numerics under the BLAS kernel {kernel}", flush=True)
    command = [sys.executable, "-m", "pytest", "-n", "2", "--dist", "worksteal", "-m",
               TIERS["--slow" in sys.argv],
               *(f"tests/estimator/{name}" for name in TESTS)]
    return subprocess.run(command, env=os.environ | {"OPENBLAS_CORETYPE": kernel}, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
