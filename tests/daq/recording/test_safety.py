"""However a recording ends, the torque is off within the watchdog's time: shown by the firmware's own record.

The firmware is the C core in a process of its own; `legid record` is another, which is interrupted, ended, crashed or
killed while it drives. What the firmware says it was commanded is all that counts here.
"""

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from daq.recording import Plan, write_plan
from daq.runs import read_run
from drivers import State
from drivers.protocol import Fault
from tests.support.c_firmware import Change, Served
from tests.support.paths import ROOT
from tests.support.processes import REAL_CLOCK

pytestmark = REAL_CLOCK

RIG = """[mechanism]
model = "leg2"
actuated = [2]
[devices.controller]
port = "{port}"
watchdog_ms = {watchdog_ms}
[limits]
staleness_s = 5.0
clock_bound_s = 5.0
"""
CRASH = """
import sys
from drivers.leg_controller import LegController
from {module} import {cls}
from legid.cli import main
command, work, sent = LegController.command, {cls}.{method}, []

def note(self, torque_nm):
    sent.append(torque_nm)
    return command(self, torque_nm)

def crash(self, *args, **kwargs):
    if len(sent) > 60:
        raise RuntimeError("crashed on purpose")
    return work(self, *args, **kwargs)

LegController.command = note
{cls}.{method} = crash
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture
def firmware() -> Iterator[Served]:
    with Served() as served:
        yield served


class Recording:
    """`legid record` of a torque that is always there, on the firmware's port."""

    def __init__(self, firmware: Served, folder: Path, watchdog_ms: int, limits: str = "", program: str = "") -> None:
        self.run = folder / "run.mcap"
        rig, plan, t = folder / "rig.toml", folder / "plan.csv", np.arange(0.0, 60.0, 0.01)
        rig.write_text(RIG.format(port=firmware.path, watchdog_ms=watchdog_ms) + limits)
        write_plan(Plan(t, 0.3 + 0.1 * np.sin(20 * t)), plan)
        start = ["-c", program] if program else ["-m", "legid.cli"]
        self.child = subprocess.Popen(
            [sys.executable, *start, "record", "--rig", rig, "--plan", plan, "--out", self.run], cwd=ROOT,
            stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
        self.firmware = firmware

    def driving(self) -> None:
        """Wait until the motor has had its torque for a while."""
        self.firmware.record_until(lambda change: len(self.firmware.changes) > 40)

    def failed(self, status: int = 1) -> str:
        """What was said by one that ended with this status."""
        _, said = self.child.communicate(timeout=60)
        assert self.child.returncode == status
        return said

    def off(self) -> Change:
        """The firmware's change to a state other than ARMED."""
        return self.firmware.record_until(lambda change: change.state != State.ARMED)[-1]


@pytest.mark.parametrize("number, said", [
    (signal.SIGINT, "stopped by Ctrl-C"), (signal.SIGTERM, "stopped by SIGTERM"), (signal.SIGHUP, "by SIGHUP")])
def test_signals_ramp_down_and_stop(firmware: Served, tmp_path: Path, number: int, said: str) -> None:
    recording = Recording(firmware, tmp_path, 1000)
    recording.driving()
    recording.child.send_signal(number)
    end = recording.off()
    assert (end.state, end.torque_unm, end.faults) == (State.DISARMED, 0, 0)
    words = recording.failed()
    assert said in words and "internal error" not in words
    # ramped down first, then disarmed; the last zero and the stop may reach the firmware in one chunk
    last = firmware.changes[-2]
    assert last.state == State.ARMED
    assert abs(last.torque_unm) < 0.1 * max(abs(c.torque_unm) for c in firmware.changes)


def test_a_killed_process_is_stopped_by_the_watchdog_in_its_time(firmware: Served, tmp_path: Path) -> None:
    recording = Recording(firmware, tmp_path, 400)
    recording.driving()
    recording.child.kill()
    end = recording.off()
    assert [(c.state, c.torque_unm) for c in firmware.changes[:2]] == [(State.DISARMED, 0), (State.ARMED, 0)]
    assert (end.state, end.torque_unm, end.faults) == (State.FAULT, 0, Fault.WATCHDOG)
    assert 400_000_000 <= end.value <= 400_500_000  # by the firmware's clock, since the last command, 1e-6 ms
    recording.failed(-signal.SIGKILL)
    raw = read_run(recording.run)
    assert not raw.complete and raw.streams["/leg/telemetry"].size > 100


def test_a_process_that_hangs_is_stopped_by_the_watchdog(firmware: Served, tmp_path: Path) -> None:
    recording = Recording(firmware, tmp_path, 400)
    recording.driving()
    recording.child.send_signal(signal.SIGSTOP)
    end = recording.off()
    recording.child.send_signal(signal.SIGCONT)
    assert (end.torque_unm, end.faults) == (0, Fault.WATCHDOG)
    assert 400_000_000 <= end.value <= 400_500_000
    words = recording.failed()
    assert "watchdog" in words or "disarmed" in words or "limit" in words


@pytest.mark.parametrize("module, cls, method", [
    ("daq.recording.intake", "ControllerIntake", "poll"), ("daq.runs.mcap_run", "RunWriter", "add"),
    ("daq.recording.supervisor", "Supervisor", "check"), ("drivers.leg_controller", "LegController", "ping")],
    ids=["reader thread", "writer thread", "main thread", "clock probes"])
def test_a_crash_of_any_thread_stops_the_motor(firmware: Served, tmp_path: Path, module: str, cls: str, method: str
                                               ) -> None:
    program = CRASH.format(module=module, cls=cls, method=method)
    recording = Recording(firmware, tmp_path, 1000, program=program)
    end = recording.off()
    assert (end.state, end.torque_unm, end.faults) == (State.DISARMED, 0, 0)  # stopped, not left to the watchdog
    words, told = recording.failed(), read_run(recording.run).events[-1].text
    assert "crashed on purpose" in words and "Traceback" not in words
    assert "crashed on purpose" in told and "stop sent" in told


def test_the_limit_that_acted_is_named_to_the_user_and_in_the_file(firmware: Served, tmp_path: Path) -> None:
    recording = Recording(firmware, tmp_path, 1000, "temperature_degc = 20.0\n")  # the motor has 25
    assert ("limit temperature_degc tripped: motor temperature in degC is 25, allowed is 20"
            in recording.failed())
    raw = read_run(recording.run)
    assert raw.complete and raw.events[-1].kind == "limit temperature_degc"
