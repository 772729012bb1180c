"""The recorder over the emulated rig: what is recorded, and that every way out ends with the motor stopped."""

import os
import re
import signal
import threading
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
def b(path: Path) -> RigBench:
    return RigBench(path)


def test_a_plan_is_commanded_and_recorded_whole(b: RigBench) -> None:
    seen, planned = [], sine()
    report = b.record(planned, on_progress=lambda now, total: seen.append(now))
    raw = read_run(b.path)
    assert raw.complete and [e.kind for e in raw.events] == ["start", "stop"]
    telemetry, imu = raw.streams["/leg/telemetry"], raw.streams["/imu"]
    for stream, count, size in ((telemetry, "seq", 3.3 * 500), (imu, "index", 3.3 * 240.8)):
        assert (np.diff(stream[count].astype(np.int64)) == 1).all() and stream.size == pytest.approx(size, rel=0.05)
    assert (report.imu_samples, report.late_commands) == (imu.size, 0)
    assert 25 <= raw.streams["/leg/clock"].size <= 40  # probes: 20 Hz while leading in, then 4 Hz
    commands = raw.streams["/leg/command"]
    commands = commands[commands["host_ns"] > raw.events[0].host_ns][: planned.time_s.size]
    np.testing.assert_allclose(commands["torque_nm"], planned.torque_nm)
    times = commands["host_ns"]
    assert np.abs((times - times[0]) * 1e-9 - planned.time_s).max() < 3e-3
    assert seen[-1] == pytest.approx(1.99) and np.diff(imu["drain_before_ns"]).max() < 15e6
    assert b.firmware.drive.state == State.DISARMED
    assert not load_run(b.path, parse_rig(RIG)).gap().any()


def test_the_motor_gets_the_planned_torque_and_none_before_or_after(b: RigBench) -> None:
    b.record(sine())
    t_ns, commanded, _ = b.firmware.motor.record
    on = (t_ns - read_run(b.path).events[0].host_ns) * 1e-9
    assert not commanded[(on < 0) | (on > 2.02)].any()
    inside = (on > 0.02) & (on < 1.98)
    lag = np.interp(on[inside] - 0.005, sine().time_s, sine().torque_nm)
    assert np.abs(commanded[inside] - lag).max() < 0.05


def test_slow_plans_keep_the_watchdog_fed(b: RigBench) -> None:
    report = b.record(Plan(np.array([0.0, 0.5, 1.0]), np.array([0.1, 0.2, 0.0])))
    assert report.commands > 1.5 / 0.1
    _, commanded, _ = b.firmware.motor.record
    assert set(np.round(commanded, 6)) == {0.0, 0.1, 0.2}


@pytest.mark.parametrize("plant, limits, named, firmware", [
    (Turning(2.0, 3.0), "q2_rad = 0.5\n", "q2_rad", {}),
    (Turning(2.0, 8.0), "speed_radps = 5.0\n", "speed_radps", {}),
    (StillPlant(StillState(q1=1.0)), "q1_rad = 0.9\n", "q1_rad", {}),
    (StillPlant(), "temperature_degc = 40.0\n", "temperature_degc", {"ambient_degc": 45.0}),
    (StillPlant(), "torque_nm = 0.6\ntorque_band_nm = 1.0\n", "torque_nm", {"shunt_offset_a": 0.4}),
    (StillPlant(), "clock_bound_s = 1e-6\n", "clock_bound_s", {}),
])
def test_a_limit_stops_the_run_and_is_named(path: Path, plant: Any, limits: str, named: str,
                                            firmware: dict[str, Any]) -> None:
    b = RigBench(path, plant, **firmware)
    line, raw = b.fails(sine(), limits)
    assert line.startswith(f"limit {named} tripped: ")
    assert raw.complete and raw.streams["/leg/telemetry"].size > 0
    assert raw.events[-1].kind == f"limit {named}" and "stop sent" in raw.events[-1].text


def test_after_a_trip_the_torque_goes_to_zero_in_a_ramp(b: RigBench) -> None:
    hot = at(0.5, lambda: setattr(b.firmware, "motor_degc", 75.0))
    line, raw = b.fails(Plan(np.arange(0, 3, 0.01), np.full(300, 0.4)), on_progress=hot)
    assert "temperature_degc" in line
    commands = raw.streams["/leg/command"]["torque_nm"]
    falling = commands[np.flatnonzero(commands == 0.4)[-1]:]
    assert falling[-1] == 0.0 and falling.size > 10
    steps = np.diff(falling)
    assert steps.max() < 0 and steps.min() > -0.4 * 0.012 / RAMP_S  # no step larger than 12 ms of the ramp
    _, commanded, _ = b.firmware.motor.record
    assert np.abs(np.diff(commanded)).max() < 0.41


@pytest.mark.parametrize("torque_nm, at_once", [(0.4, True), (-0.4, False)])
def test_towards_the_limit_torque_is_cut_at_once_against_it_ramps(path: Path, torque_nm: float, at_once: bool
                                                                  ) -> None:
    b = RigBench(path, Turning(2.0, 3.0))
    line, raw = b.fails(Plan(np.arange(0, 3, 0.01), np.full(300, torque_nm)), "q2_rad = 0.5\n")
    assert line.startswith("limit q2_rad tripped: knee angle after stopping")
    telemetry = raw.streams["/leg/telemetry"]
    tripped_rad = telemetry["knee_rad"][telemetry["state"] == State.ARMED][-1]
    assert tripped_rad < 0.5 + 3.0 * (0.0 if at_once else RAMP_S) - 0.5 * 3.0**2 / 100.0
    commands = raw.streams["/leg/command"]["torque_nm"]
    assert (commands[-1] == torque_nm) == at_once


@pytest.mark.parametrize("strike, said", [
    (lambda b: setattr(b.mock.imu, "push", lambda raw: None), "limit staleness_s tripped: silence of the IMU"),
    (lambda b: setattr(b.link, "read", lambda: (b.clock.sleep(0.001), b"")[1]),
     "limit staleness_s tripped: silence of the leg controller"),
    (lambda b: setattr(b.firmware, "knee_encoder_ok", False), ".*knee")],
    ids=["IMU", "controller", "knee encoder"])
def test_a_device_that_falls_silent_or_is_faulty_is_named(b: RigBench, strike: Any, said: str) -> None:
    line, raw = b.fails(sine(), on_progress=at(0.5, lambda: strike(b)))
    assert re.match(said, line) and raw.complete and raw.streams["/imu"].size > 200


def test_a_pulled_cable_is_said_and_the_run_kept(b: RigBench) -> None:
    line, raw = b.fails(sine(), on_progress=at(0.5, b.link.unplug))
    assert "connection is gone" in line and raw.complete and "watchdog stops the motor" in raw.events[-1].text
    with pytest.raises(LinkLost):
        b.controller.stop()


def test_a_reboot_of_the_controller_ends_the_run(b: RigBench) -> None:
    line, raw = b.fails(sine(), on_progress=at(0.7, b.firmware.reboot))
    assert "restarted during the run" in line and "reboot" in [e.kind for e in raw.events]
    assert np.unique(raw.streams["/leg/telemetry"]["boot_id"]).size <= 2
    assert len(load_run(b.path, parse_rig(RIG))) > 100


def test_a_bus_error_is_a_gap_not_the_end(b: RigBench) -> None:
    b.record(sine(), on_progress=at(0.5, lambda: b.mock.imu.fail(121, times=4)))
    raw = read_run(b.path)
    assert "imu gap" in [e.kind for e in raw.events] and raw.streams["/imu"]["gap_before"].any()


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
    b.firmware.transmit(b.clock.now_ns())
    assert b.firmware.drive.state == State.DISARMED
    raw = read_run(b.path)
    assert raw.complete and "internal error" in raw.events[-1].text


# -- on the real clock, with threads, over a PTY ---------------------------------------------------------------


def test_threads_record_the_same_on_the_real_clock(path: Path) -> None:
    before = set(threading.enumerate())  # a test of a hung disk leaves its writer behind
    report = threaded(path, sine(0.8))
    raw = read_run(path)
    assert raw.complete and report.messages == raw.messages
    telemetry = raw.streams["/leg/telemetry"]
    assert telemetry.size > 200 and (np.diff(telemetry["tick_us"].astype(np.int64)) > 0).all()
    assert raw.streams["/imu"].size == report.imu_samples > 100
    run = load_run(path, parse_rig(RIG))
    assert {"q2_rad", "q1_rad", "tau2_nm", "gyro_radps", "tau2_cmd_nm", "temperature_degc"} <= set(run.columns)
    assert not [t for t in threading.enumerate() if t.name in ("leg", "imu", "writer") and t not in before]


@REAL_CLOCK
@pytest.mark.parametrize("number, said", [
    (signal.SIGINT, "stopped by Ctrl-C"), (signal.SIGTERM, "stopped by SIGTERM"),
    (signal.SIGHUP, "stopped by SIGHUP")])
def test_signals_end_in_a_stop(path: Path, number: int, said: str) -> None:
    handler = signal.getsignal(number)
    with pytest.raises(WorkError, match=said):
        threaded(path, sine(5.0), at(0.1, lambda: os.kill(os.getpid(), number)))
    assert signal.getsignal(number) is handler
    raw = read_run(path)
    assert raw.complete and raw.events[-1].kind == "abort" and "stop sent" in raw.events[-1].text


def test_a_thread_that_crashes_ends_in_a_stop(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def crash(self: Lsm9ds1) -> Any:
        raise LinkLost("the IMU thread died")

    with pytest.raises(WorkError, match="the IMU thread died"):
        threaded(path, sine(5.0), at(0.1, lambda: monkeypatch.setattr(Lsm9ds1, "drain", crash)))
    assert read_run(path).events[-1].kind == "abort"
