"""One case, diagnosed by `legid diagnose` in a process of its own, as a user types it."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from evidence.blind.plan import PlannedCase

LIMIT_S = 900.0
COMMAND = (sys.executable, "-m", "legid.cli")
# The command itself can leave no effect out, nor should it: a process of the bench takes one from the library first.
WITHOUT = """
import sys
from estimator.effects import registry
gone = sys.argv.pop(1)
every = registry.library_classes()
left = tuple(kind for kind in every if kind.name != gone)
if len(left) != len(every) - 1:
    sys.exit(f"the library has no effect {gone} to leave out")
registry.library_classes = lambda: left
from legid.cli import main
sys.exit(main())
"""


def command_of(case: PlannedCase, cases: Path, answer: Path, share: int = 1) -> list[str]:
    """The command line that diagnoses a case on `share` processes."""
    folder = cases / case.name
    without = [sys.executable, "-c", WITHOUT, case.effects[0]] if case.kind == "deleted" else list(COMMAND)
    runs = [str(folder / f"r{k}.csv") for k in range(1, len(list(folder.glob("r*.csv"))) + 1)]
    return [*without, "diagnose", *runs, "--rig", str(folder / "rig.toml"), "--json", str(answer),
            "--workers", str(share)]


def diagnose(case: PlannedCase, cases: Path, out: Path, limit_s: float = LIMIT_S, share: int = 1) -> dict[str, Any]:
    """The diagnosis JSON of one case, kept in `out`; its `bench` has exit status, wall and processor time [s] and the
    last words on stderr.

    A diagnosis that leaves no JSON (an internal error, a limit) is kept as `fit_failed`, with what it said.
    """
    answer = out / f"{case.name}.part"
    answer.unlink(missing_ok=True)
    start = time.perf_counter()
    status, said, cpu_s = _finish(command_of(case, cases, answer, share), limit_s)
    if status in (0, 1) and answer.exists():
        found = json.loads(answer.read_text())
        found["bench"] = {"status": status, "crashed": False}
    else:
        found = failed("", status)
    found["bench"] |= {"wall_s": time.perf_counter() - start, "cpu_s": cpu_s, "said": said if status != 0 else ""}
    keep(found, case, out)
    return found


def failed(said: str, status: int | None = None) -> dict[str, Any]:
    """What is kept of a case that has no diagnosis."""
    return {"verdict": "fit_failed", "causes": [], "bench": {"status": status, "crashed": True, "said": said}}


def keep(found: dict[str, Any], case: PlannedCase, out: Path) -> None:
    """Write the answer of a case, whole or not at all."""
    part = out / f"{case.name}.part"
    part.write_text(json.dumps(found, indent=1))
    part.replace(out / f"{case.name}.json")


def _finish(command: list[str], limit_s: float) -> tuple[int | None, str, float]:
    """Exit status (None after the limit), last line on stderr and processor time [s] of a command and its children."""
    end = time.monotonic() + limit_s
    with TemporaryFile() as stderr:
        # a session of its own: an interrupt of the bench must not be kept as a diagnosis that failed
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=stderr, start_new_session=True)
        late = False
        while not (found := os.wait4(process.pid, os.WNOHANG))[0]:
            if not late and time.monotonic() > end:
                late = True
                os.killpg(process.pid, signal.SIGKILL)
            time.sleep(0.02)
        process.returncode = os.waitstatus_to_exitcode(found[1])
        stderr.seek(0)
        lines = stderr.read().decode(errors="replace").strip().splitlines()
    cpu_s = found[2].ru_utime + found[2].ru_stime
    if late:
        return None, f"not done after {limit_s:.0f} s", cpu_s
    return process.returncode, (lines or [""])[-1], cpu_s


def parse_seeds(text: str) -> list[int]:
    """N or A-B, several after commas."""
    spans = (part.partition("-") for part in filter(None, text.split(",")))
    return [seed for low, _, high in spans for seed in range(int(low), int(high or low) + 1)]
