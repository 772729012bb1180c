"""Commands started to be killed, and what is left of them; tests that run on the clock of this machine."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.support.paths import ROOT

REAL_CLOCK = pytest.mark.flaky(reruns=2, reruns_delay=5)
"""Emulated devices and the program on the clock of this machine: one that gives its processors to others for a second
starves both, and the program rightly says so. Such a test is begun again, which a defect fails as often."""

PATIENCE_S = 60.0
"""After which a process that should have gone is said to stay; a busy machine needs seconds."""


def start_python(*arguments: str, cwd: Path = ROOT) -> subprocess.Popen[str]:
    """In a session of its own, by whose number everything that it starts is found again; it hears Ctrl-C and a
    terminal that closes also where these tests run in the background of a script, or under nohup, which do not."""
    def hear() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.signal(signal.SIGHUP, signal.SIG_DFL)

    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    return subprocess.Popen([sys.executable, *arguments], cwd=cwd, start_new_session=True, text=True, preexec_fn=hear,
                            env={**os.environ, "PYTHONPATH": path},
                            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


def of_session(leader: int) -> set[int]:
    """Process ids of the session that live, the leader's own among them."""
    return {int(stat.parent.name) for stat in Path("/proc").glob("[0-9]*/stat")
            if (found := _status(stat))[3:4] == [str(leader)] and found[0] != "Z"}


def until(true: Callable[[], object], patience_s: float = PATIENCE_S) -> bool:
    """Whether it came true before patience ended."""
    deadline = time.monotonic() + patience_s
    while not true():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


@contextmanager
def favoured() -> Iterator[None]:
    """What is started meanwhile goes before other work of this machine, where that is granted: it is being timed."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -15)
    try:
        yield
    finally:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, before)


def _status(stat: Path) -> list[str]:
    """State, parent, group, session and so on; empty where the process is gone."""
    try:
        return stat.read_text().rsplit(")", 1)[1].split()
    except OSError:
        return []


def ran(*words: object, cwd: Path = ROOT, status: int = 0) -> subprocess.CompletedProcess[str]:
    """Python with these arguments and the checkout's packages, which must end so."""
    done = subprocess.run([sys.executable, *map(str, words)], cwd=cwd, text=True, capture_output=True, check=False,
                          env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert done.returncode == status, done.stdout + done.stderr
    return done


def evidence(*words: object) -> str:
    """What `python -m evidence` prints, which must end well."""
    return ran("-m", "evidence", *words).stdout
