"""`legid calibrate all` on a terminal of its own, against a rig that is served as real devices are."""

import os
import pty
import re
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

from daq import load_rig
from experiments.emulation import ServedRig
from tests.support.motor_off_runs import RIG
from tests.support.paths import ROOT
from tests.support.processes import REAL_CLOCK
from tests.support.shell import Answers, Shell

pytestmark = REAL_CLOCK

PATIENCE_S = 60.0


class Terminal:
    """A process whose standard streams are a terminal, and what it has said."""

    def __init__(self, *args: str) -> None:
        self.ours, theirs = pty.openpty()
        self.process = subprocess.Popen([sys.executable, "-m", "legid.cli", *args], cwd=ROOT, stdin=theirs,
                                        stdout=theirs, stderr=theirs, close_fds=True)
        os.close(theirs)
        self.said, self.read_to = "", 0

    def wait_for(self, words: str) -> str:
        """What was said since the last time, up to `words`."""
        end = time.monotonic() + PATIENCE_S
        while words not in self.said[self.read_to:]:
            assert time.monotonic() < end and self._more(end), f"no {words!r} in {self.said[self.read_to:]!r}"
        at = self.said.index(words, self.read_to) + len(words)
        part, self.read_to = self.said[self.read_to: at], at
        return part

    def _more(self, end: float) -> bool:
        if not select.select([self.ours], [], [], max(end - time.monotonic(), 0.0))[0]:
            return False
        try:
            data = os.read(self.ours, 4096)
        except OSError:  # the other end is closed
            return False
        self.said += data.decode()
        return bool(data)

    def answer(self, text: str = "") -> None:
        os.write(self.ours, f"{text}\n".encode())

    def close(self) -> int:
        while self._more(time.monotonic() + PATIENCE_S):
            pass
        os.close(self.ours)
        return self.process.wait(PATIENCE_S)


def test_a_walk_with_a_failure_and_steps_left_out(tmp_path: Path) -> None:
    with ServedRig(tmp_path) as served:
        text = served.rig_path.read_text()
        wrong = re.sub(r"(?m)^(knee_zero_rad|shunt_offset_a) = .*$", r"\1 = 0.0  # not yet known", text)
        served.rig_path.write_text(wrong)
        walk = Terminal("calibrate", "all", "--rig", str(served.rig_path), "--straight", "--seconds", "1.2")
        assert "Let the leg hang still" in walk.wait_for("Enter to begin, s to skip, q to stop: ")
        walk.answer()
        assert "are too short" in walk.wait_for("Enter to try again")  # 1.2 s do not do for a gyro's bias
        walk.answer("s")
        assert "Step 2 of 4, mount" in walk.wait_for("Enter to begin")
        walk.answer("s")
        assert "Hold or clamp the leg straight" in walk.wait_for("Enter to begin")
        walk.answer("what?")  # no answer to that question: it asks again
        walk.wait_for("Enter to begin")
        walk.answer()
        assert "motor off" in walk.wait_for("knee_zero_rad written")
        walk.wait_for("Step 4 of 4, shunt")
        walk.wait_for("Enter to begin")
        walk.answer()
        walk.wait_for("torque_offset.2 written")
        assert walk.close() == 0, walk.said
        summary = walk.said[walk.read_to:]
    assert re.search(r"imu +skipped: .* too short", summary) and re.search(r"mount +skipped", summary)
    assert re.search(r"encoder +knee_zero_rad = 0\.21", summary) and re.search(r"shunt +shunt_offset_a", summary)
    found = load_rig(served.rig_path).calibration
    assert found.knee_zero_rad == pytest.approx(0.215, abs=2e-3)
    assert found.shunt_offset_a == pytest.approx(0.031, abs=0.01)
    assert "# not yet known" in served.rig_path.read_text()


def test_no_terminal_no_devices_and_an_early_end(here: Path, shell: Shell, answers: Answers,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    path = here / "rig.toml"
    path.write_text(RIG + '\n[devices.imu]\nbus = "/dev/i2c-1"\n')
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    shell("calibrate all --rig rig.toml", status=2)
    assert "not a terminal" in (error := shell.err) and error.count("\n") == 1
    answers(*"ssss")
    shell("calibrate all --rig rig.toml")
    assert shell.out.count("has no [devices.controller]") == 2
    answers("q")
    shell("calibrate all --rig rig.toml")
    assert "Step 2" not in (said := shell.out) and "stopped here" in said
    assert path.read_text().startswith(RIG)
