"""The recorder over the emulated rig: what is recorded, and that every way out ends with the motor stopped."""

import math
import os
import re
import signal
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq import InputError, WorkError, parse_rig
from daq.recording import Plan
from daq.recording.recorder import RAMP_S
from daq.runs import read_run
from drivers import LinkLost, Lsm9ds1, State
from tests.support.processes import REAL_CLOCK
from tests.support.recordings import RIG, Turning, at, sine, threaded
from tests.support.runs import load_run
from tests.support.sensor_bench import RigBench
from tests.support.still_plant import StillPlant, StillState


@pytest.fixture
def b(tmp_path: Path) -> RigBench:
    return RigBench(tmp_path / "r.mcap")


def test_a_plan_is_commanded_and_recorded_whole(b: RigBench) -> None:
    seen = []
    report = b.record(sine(), on_progress=lambda now, total: seen.append((now, total)))
    raw = read_run(b.path)
    assert raw.complete
    telemetry, imu = raw.streams["/leg/telemetry"], raw.streams["/imu"]
    assert (np.diff(telemetry["seq"].astype(int)) == 1).all()
    assert (np.diff(imu["index"].astype(np.int64)) == 1).all()
    assert report.imu_samples == imu.size
    assert telemetry.size == pytest.approx(3.3 * 500, rel=0.05)
    assert imu.size == pytest.approx(3.3 * 240.8, rel=0.05)
    assert [e.kind for e in raw.events] == ["start", "stop"]
    # probes: 20 Hz while leading in, then 4 Hz
    assert 25 <= raw.streams["/leg/clock"].size <= 40
    commands = raw.streams["/leg/command"]
    planned = sine()
    from_start = commands["host_ns"] > raw.events[0].host_ns
    times = commands["host_ns"][from_start]
    np.testing.assert_allclose(commands["torque_nm"][from_start][: planned.torque_nm.size], planned.torque_nm)
    assert np.abs((times[: planned.time_s.size] - times[0]) * 1e-9 - planned.time_s).max() < 3e-3
    assert report.late_commands == 0
    assert seen[-1][0] == pytest.approx(1.99)
    assert np.diff(imu["drain_before_ns"]).max() < 15e6
    assert b.mock.firmware.drive.state == State.DISARMED
    assert not load_run(b.path, parse_rig(RIG)).gap().any()


def test_the_motor_gets_the_planned_torque_and_none_before_or_after(b: RigBench) -> None:
    b.record(sine())
    t_ns, commanded, _ = b.mock.firmware.motor.record
    start = read_run(b.path).events[0].host_ns
    on = (t_ns - start) * 1e-9
    assert (commanded[on < 0] == 0).all()
    assert (commanded[on > 2.02] == 0).all()
    inside = (on > 0.02) & (on < 1.98)
    lag = np.interp(on[inside] - 0.005, sine().time_s + 0.0, sine().torque_nm)
    assert np.abs(commanded[inside] - lag).max() < 0.05


def test_slow_plans_keep_the_watchdog_fed(b: RigBench) -> None:
    report = b.record(Plan(np.array([0.0, 0.5, 1.0]), np.array([0.1, 0.2, 0.0])))
    assert report.commands > 1.5 / 0.1
    _, commanded, _ = b.mock.firmware.motor.record
    assert set(np.round(commanded, 6)) == {0.0, 0.1, 0.2}


@pytest.mark.parametrize("plant, limits, named, firmware", [
    (Turning(2.0, 3.0), "q2_rad = 0.5\n", "q2_rad", {}),
    (Turning(2.0, 8.0), "speed_radps = 5.0\n", "speed_radps", {}),
    (StillPlant(StillState(q1=1.0)), "q1_rad = 0.9\n", "q1_rad", {}),
    (StillPlant(), "temperature_degc = 40.0\n", "temperature_degc", {"ambient_degc": 45.0}),
    (StillPlant(), "torque_nm = 0.6\ntorque_band_nm = 1.0\n", "torque_nm", {"shunt_offset_a": 0.4}),
    (StillPlant(), "clock_bound_s = 1e-6\n", "clock_bound_s", {}),
])
def test_a_limit_stops_the_run_and_is_named(tmp_path: Path, plant: Any, limits: str, named: str,
                                            firmware: dict[str, Any]) -> None:
    b = RigBench(tmp_path / "r.mcap", plant, **firmware)
    line, raw = b.fails(sine(), limits)
    assert line.startswith(f"limit {named} tripped: ")
    assert raw.complete
    assert raw.events[-1].kind == f"limit {named}"
    assert "stop sent" in raw.events[-1].text
    assert raw.streams["/leg/telemetry"].size > 0


def test_after_a_trip_the_torque_goes_to_zero_in_a_ramp(b: RigBench) -> None:
    hot = at(0.5, lambda: setattr(b.mock.firmware, "motor_degc", 75.0))
    line, raw = b.fails(Plan(np.arange(0, 3, 0.01), np.full(300, 0.4)), on_progress=hot)
    assert "temperature_degc" in line
    commands = raw.streams["/leg/command"]["torque_nm"]
    falling = commands[np.flatnonzero(commands == 0.4)[-1]:]
    assert falling[-1] == 0.0
    assert falling.size > 10
    assert (np.diff(falling) < 0).all()
    assert np.diff(falling).min() > -0.4 * 0.012 / RAMP_S  # no step larger than 12 ms of the ramp
    _, commanded, _ = b.mock.firmware.motor.record
    assert np.abs(np.diff(commanded)).max() < 0.41


@pytest.mark.parametrize("torque_nm, at_once", [(0.4, True), (-0.4, False)])
def test_towards_the_limit_torque_is_cut_at_once_against_it_ramps(tmp_path: Path, torque_nm: float, at_once: bool
                                                                  ) -> None:
    b = RigBench(tmp_path / "r.mcap", Turning(2.0, 3.0))
    line, raw = b.fails(Plan(np.arange(0, 3, 0.01), np.full(300, torque_nm)), "q2_rad = 0.5\n")
    assert line.startswith("limit q2_rad tripped: knee angle after stopping")
    tripped_rad = raw.streams["/leg/telemetry"]["knee_rad"][raw.streams["/leg/telemetry"]["state"] == State.ARMED][-1]
    assert tripped_rad < 0.5 + 3.0 * (0.0 if at_once else RAMP_S) - 0.5 * 3.0**2 / 100.0
    commands = raw.streams["/leg/command"]["torque_nm"]
    after = commands.size - 1 - int(np.flatnonzero(commands == torque_nm)[-1])
    assert (after == 0) is at_once


@pytest.mark.parametrize("strike, said", [
    (lambda b: setattr(b.mock.imu, "push", lambda raw: None), "limit staleness_s tripped: silence of the IMU"),
    (lambda b: setattr(b.link, "read", lambda: (b.clock.sleep(0.001), b"")[1]),
     "limit staleness_s tripped: silence of the leg controller"),
    (lambda b: setattr(b.mock.firmware, "knee_encoder_ok", False), ".*knee")],
    ids=["IMU", "controller", "knee encoder"])
def test_a_device_that_falls_silent_or_is_faulty_is_named(b: RigBench, strike: Any, said: str) -> None:
    line, raw = b.fails(sine(), on_progress=at(0.5, lambda: strike(b)))
    assert re.match(said, line) and raw.complete
    assert raw.streams["/imu"].size > 200


def test_a_pulled_cable_is_said_and_the_run_kept(b: RigBench) -> None:
    line, raw = b.fails(sine(), on_progress=at(0.5, b.link.unplug))
    assert "connection is gone" in line
    assert raw.complete
    assert "watchdog stops the motor" in raw.events[-1].text
    with pytest.raises(LinkLost):
        b.controller.stop()


def test_a_reboot_of_the_controller_ends_the_run(b: RigBench) -> None:
    line, raw = b.fails(sine(), on_progress=at(0.7, b.mock.firmware.reboot))
    assert "restarted during the run" in line
    assert "reboot" in [e.kind for e in raw.events]
    assert np.unique(raw.streams["/leg/telemetry"]["boot_id"]).size <= 2
    assert len(load_run(b.path, parse_rig(RIG))) > 100


def test_a_bus_error_is_a_gap_not_the_end(b: RigBench) -> None:
    b.record(sine(), on_progress=at(0.5, lambda: b.mock.imu.fail(121, times=4)))
    raw = read_run(b.path)
    assert "imu gap" in [e.kind for e in raw.events]
    assert raw.streams["/imu"]["gap_before"].sum() >= 1


def test_a_plan_beyond_the_limits_is_refused_before_a_file_is_made(b: RigBench) -> None:
    with pytest.raises(InputError, match=r"plan: asks for 0\.5 N m, limits\.torque_nm of the rig is 0\.4"):
        b.record(sine(), "torque_nm = 0.4\n")
    with pytest.raises(InputError, match="the firmware's limit is 2 N m"):
        b.record(sine(peak_nm=3.0), "torque_nm = 5.0\n")
    assert not b.path.exists()


def test_a_failure_of_the_program_itself_stops_the_motor_too(b: RigBench) -> None:
    with pytest.raises(ZeroDivisionError):
        b.record(sine(), on_progress=at(0.5, lambda: 1 / 0))
    b.clock.sleep(0.01)
    b.mock.firmware.transmit(b.clock.now_ns())
    assert b.mock.firmware.drive.state == State.DISARMED
    raw = read_run(b.path)
    assert raw.complete
    assert "internal error" in raw.events[-1].text


# -- on the real clock, with threads, over a PTY ---------------------------------------------------------------


def test_threads_record_the_same_on_the_real_clock(tmp_path: Path) -> None:
    before = set(threading.enumerate())  # a test of a hung disk leaves its writer behind
    report = threaded(tmp_path / "r.mcap", sine(0.8))
    raw = read_run(tmp_path / "r.mcap")
    assert raw.complete
    assert report.messages == raw.messages
    assert raw.streams["/leg/telemetry"].size > 200
    assert (np.diff(raw.streams["/leg/telemetry"]["tick_us"].astype(np.int64)) > 0).all()
    assert raw.streams["/imu"].size == report.imu_samples > 100
    run = load_run(tmp_path / "r.mcap", parse_rig(RIG))
    assert {"q2_rad", "q1_rad", "tau2_nm", "gyro_radps", "tau2_cmd_nm", "temperature_degc"} <= set(run.columns)
    assert not [t for t in threading.enumerate() if t.name in ("leg", "imu", "writer") and t not in before]


@REAL_CLOCK
@pytest.mark.parametrize("number, said", [
    (signal.SIGINT, "stopped by Ctrl-C"), (signal.SIGTERM, "stopped by SIGTERM"),
    (signal.SIGHUP, "stopped by SIGHUP")])
def test_signals_end_in_a_stop(tmp_path: Path, number: int, said: str) -> None:
    handler = signal.getsignal(number)
    with pytest.raises(WorkError, match=said):
        threaded(tmp_path / "r.mcap", sine(5.0), at(0.1, lambda: os.kill(os.getpid(), number)))
    assert signal.getsignal(number) is handler
    raw = read_run(tmp_path / "r.mcap")
    assert raw.complete
    assert raw.events[-1].kind == "abort"
    assert "stop sent" in raw.events[-1].text


def test_a_thread_that_crashes_ends_in_a_stop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def crash(self: Lsm9ds1) -> Any:
        if time.monotonic() > crash_at:
            raise LinkLost("the IMU thread died")
        return drain(self)

    drain, crash_at = Lsm9ds1.drain, math.inf

    def begin() -> None:
        nonlocal crash_at
        crash_at = time.monotonic()

    monkeypatch.setattr(Lsm9ds1, "drain", crash)
    with pytest.raises(WorkError, match="the IMU thread died"):
        threaded(tmp_path / "r.mcap", sine(5.0), at(0.1, begin))
    assert read_run(tmp_path / "r.mcap").events[-1].kind == "abort"
