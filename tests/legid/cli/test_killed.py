"""Commands with workers, killed in earnest: nothing of them may go on, or hold a processor, afterwards."""

import os
import signal
from pathlib import Path

import pytest

from tests.support.processes import REAL_CLOCK, of_session, start_python, until

pytestmark = REAL_CLOCK

SLEEPERS = """
import time
from estimator import worker_pool
from estimator.parallel import parallel_map
def work(i):
    print(i, flush=True)
    time.sleep(10 * i)  # the first is soon idle: one that waits for work must notice, too
    time.sleep(0 if i == 0 else 600)
"""
FORKED = SLEEPERS + "parallel_map(work, 3, 3)"
SPAWNED = """
import time
from experiments.workflows import choose_executor
if __name__ == "__main__":
    list(choose_executor(2, None).run(time.sleep, [600.0, 600.0]))
"""
HARD = [signal.SIGTERM, signal.SIGKILL, signal.SIGHUP]


def kill_with_workers(arguments: list[str], number: signal.Signals, workers: int, group: bool, cwd: Path) -> str:
    """Start, wait for the workers, kill, and see everything gone. Returns what was said."""
    process = start_python(*arguments, cwd=cwd)
    try:
        assert until(lambda: len(of_session(process.pid)) > workers or process.poll() is not None)
        assert process.poll() is None, process.communicate()[0]
        (os.killpg if group else os.kill)(process.pid, number)
        assert until(lambda: not of_session(process.pid)), "workers stay behind"
        said = process.communicate()[0]
    finally:
        for pid in of_session(process.pid):
            os.kill(pid, signal.SIGKILL)
        process.wait()
    assert process.returncode == -number if number in HARD else process.returncode
    return said


@pytest.mark.parametrize("number", [*HARD, signal.SIGINT])
def test_forked_workers_end_with_their_parent(number: signal.Signals, tmp_path: Path) -> None:
    kill_with_workers(["-c", FORKED], number, 3, False, tmp_path)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_spawned_workers_end_with_their_parent(number: signal.Signals, tmp_path: Path) -> None:
    script = tmp_path / "spawned.py"
    script.write_text(SPAWNED)
    kill_with_workers([str(script)], number, 2, False, tmp_path)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("group", [False, True], ids=["alone", "whole foreground"])
def test_a_demo_ends_with_all_its_recorders(number: signal.Signals, group: bool, tmp_path: Path) -> None:
    said = kill_with_workers(["-m", "legid.cli", "demo", "--out", str(tmp_path / "demo")], number, 2, group,
                             tmp_path)
    assert "Traceback" not in said
    if number == signal.SIGINT:
        assert said.splitlines()[-1] == "legid demo: interrupted"
