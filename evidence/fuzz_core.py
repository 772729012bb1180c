"""The firmware's core under broken frames, built with address and undefined behaviour sanitizers: `make fuzz`.

    python -m evidence fuzz-core --frames 20000000 --seed 1
"""

import shutil
import subprocess
import sys
import time
from pathlib import Path

from evidence.frame import Lines, new_folder, program
from evidence.registry import Evidence
from tests.support.paths import ROOT

CORE = ROOT / "firmware"
PARTS = ("core", "config", "codec", "can")
SOURCES = [ROOT / "evidence/fuzz_core.c", *(CORE / f"leg_{part}.c" for part in PARTS)]
STRICT = ["-std=c99", "-O1", "-g", "-Wall", "-Wextra", "-Werror", "-fno-sanitize-recover=all",
          "-fsanitize=address,undefined"]


def build(compiler: str, out: Path) -> Path:
    """The fuzzer's program at `out`."""
    subprocess.run([compiler, *STRICT, "-I", str(CORE), "-o", str(out), *map(str, SOURCES)], check=True)
    return out


EVIDENCE = Evidence(
    "The firmware's core under broken frames, with sanitizers", "make fuzz FRAMES=20000000", "fuzz.md", 1,
    "no crash, no finding, no check that fails",
    (r"(crashes, findings of a sanitizer, checks that failed) \| (\d+)",), r"--seed (\d+)",
    resumes="no: a minute")


def page(frames: int = 1_000_000, seed: int = 1) -> Lines:
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        sys.exit("make fuzz needs a C compiler with sanitizers: the Debian package gcc or clang")
    with new_folder() as folder:
        program, started = build(compiler, folder / "fuzz"), time.perf_counter()
        done = subprocess.run([program, str(frames), str(seed)], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"seed {seed}: status {done.returncode}\n{done.stderr}")
    yield from ["# The firmware's core under broken frames",
                f"{done.stdout.strip()}, 0 crashes, {time.perf_counter() - started:.0f} s"]


main = program(page)

