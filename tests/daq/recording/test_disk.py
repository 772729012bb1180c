"""The motor does not outlive its measurement: a disk that hangs, a run file that is taken away, signals at the end."""

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq import WorkError
from daq.recording import Plan, recorder
from daq.recording.recorder import Recorder
from daq.runs import RunWriter, mcap_run, read_run
from drivers import LegController, State
from drivers.mock import MockRig
from tests.support.device_faults import FaultyDisk
from tests.support.recordings import at, sine, threaded

LIMITS = "staleness_s = 2.0\nclock_bound_s = 1.0\nunsaved_s = 1.3\n"


def test_a_disk_that_hangs_stops_the_motor_and_not_the_program(tmp_path: Path, mocks: list[MockRig],
                                                               monkeypatch: pytest.MonkeyPatch) -> None:
    disks, hung, create = [], [], mcap_run._create
    monkeypatch.setattr(mcap_run, "_create", lambda path: (disks.append(FaultyDisk(create(path))), disks[0])[1])
    monkeypatch.setattr(recorder, "FINISH_S", 0.5)

    def hang() -> None:
        hung.append(time.monotonic())
        disks[0]._delay_s = 8.0

    with pytest.raises(WorkError, match=r"age of what is not on the disk.*the disk does not answer"):
        threaded(tmp_path / "r.mcap", sine(20.0), at(0.2, hang), LIMITS)
    assert time.monotonic() - hung[0] < 6.0
    t_ns, commanded, _ = mocks[0].firmware.motor.record
    assert float(t_ns[commanded != 0][-1]) * 1e-9 - hung[0] < 1.3 + 0.3  # by so much it outlived the disk
    assert mocks[0].firmware.drive.state != State.ARMED


@pytest.mark.parametrize("act, said", [
    (lambda path: path.unlink(), "is not in its place any more"),
    (lambda path: os.truncate(path, 100), "was cut short to 100 of"),
    (lambda path: (path.with_suffix(".new").write_text("x"), os.replace(path.with_suffix(".new"), path)),
     "another file is in its place")])
def test_a_run_file_that_is_taken_away_stops_the_motor(path: Path, mocks: list[MockRig], act: Any, said: str
                                                       ) -> None:
    when = []
    with pytest.raises(WorkError, match=said):
        threaded(path, Plan(np.arange(0, 9, 0.01), np.full(900, 0.3)),
                 at(0.4, lambda: (when.append(time.monotonic_ns()), act(path))))
    t_ns, commanded, _ = mocks[0].firmware.motor.record
    assert (int(t_ns[commanded != 0][-1]) - when[0]) * 1e-6 < 200  # 20 ms of watching on a machine with nothing to do


def test_a_file_that_lacks_messages_is_said_when_it_is_closed(path: Path) -> None:
    writer = RunWriter(path, {})
    writer.event(1, "remark", "one")
    writer.messages += 1
    with pytest.raises(WorkError, match="holds 1 of 2 messages after closing"):
        writer.close()
    writer.close()  # said at


def test_signals_while_the_file_is_finished_break_nothing_off(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    close = Recorder._close

    def impatient(self: Recorder, why: str, stopped: str) -> None:
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            os.kill(os.getpid(), number)
            time.sleep(0.05)
        close(self, why, stopped)

    monkeypatch.setattr(Recorder, "_close", impatient)
    with pytest.raises(WorkError, match="stopped by SIGTERM"):
        threaded(path, sine(5.0), at(0.1, lambda: os.kill(os.getpid(), signal.SIGTERM)))
    raw = read_run(path)
    assert raw.complete and raw.events[-1].text.startswith("stopped by SIGTERM")


def test_a_stop_that_is_lost_is_sent_again(path: Path, mocks: list[MockRig], monkeypatch: pytest.MonkeyPatch
                                           ) -> None:
    stop = LegController.stop
    lost: list[float] = []

    def deaf(self: LegController) -> None:
        if self.armed and len(lost) < 2:
            lost.append(1)
        else:
            stop(self)

    monkeypatch.setattr(LegController, "stop", deaf)
    threaded(path, sine(0.5))
    assert len(lost) == 2
    assert mocks[0].firmware.drive.state == State.DISARMED  # and not left to the watchdog of a second
