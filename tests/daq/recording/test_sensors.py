"""Pivot sensor and second shunt beside IMU and controller: recorded, aligned, supervised; every fault ends the run."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq import Calibration, Limits, parse_rig
from daq.recording.plausibility import Plausibility
from daq.runs import read_run
from daq.timing import decode, recorded_rig
from drivers import Hello
from drivers.mock import PivotSettings, ShuntSettings
from tests.support.recordings import RIG, Turning, at
from tests.support.runs import load_run
from tests.support.sensor_bench import TABLES, SensorBench

STALE = "limit staleness_s tripped: time in s without a valid current of the second shunt"


def test_both_are_recorded_and_come_back_in_si_units(path: Path) -> None:
    bench = SensorBench(path, shunt=ShuntSettings(offset_v=2e-4))
    bench.record()
    raw = read_run(bench.path)
    assert raw.streams["/pivot"].size == pytest.approx(2.1 * 200, rel=0.12)
    assert raw.streams["/shunt"].size == raw.streams["/pivot"].size and not raw.streams["/shunt"]["flags"].any()
    data = load_run(bench.path, recorded_rig(raw), 200.0)
    assert np.abs(data["q1_rad"]).max() < 0.006  # its noise; the zero of 0.4 rad taken off, whatever its sign
    assert data["tau2_shunt_nm"].mean() == pytest.approx(0.02, abs=2e-3)  # 0.2 mV over 10 mOhm
    assert np.corrcoef(data["tau2_shunt_nm"], data["tau2_nm"])[0, 1] > 0.99
    assert "pivot sensor" in decode(raw, recorded_rig(raw)).clocks


def test_the_angle_goes_on_where_the_chip_wraps(path: Path) -> None:
    bench = SensorBench(path, Turning(0.0, 5.5, joint=1), imu=False)
    bench.fails(limits="q1_rad = 7.0\n")  # it passes the limit, more than a turn away, and not one of them sooner
    raw = read_run(bench.path)
    q1 = load_run(bench.path, recorded_rig(raw), 100.0)["q1_rad"]
    assert np.abs(np.diff(q1) - 0.055).max() < 0.01 and q1[-1] > 6.5  # no jump
    assert (np.diff(raw.streams["/pivot"]["raw"].astype(int)) > 2000).any()  # the chip's count did wrap


def test_times_are_right(path: Path) -> None:
    """A pivot that turns steadily shows by how much the sensor's times are off; without an IMU they bound the clock."""
    bench = SensorBench(path, Turning(0.3, 0.4, joint=1), imu=False, magnet=PivotSettings(-0.4, -1, 0.0))
    bench.record()
    raw = read_run(bench.path)
    data = load_run(bench.path, recorded_rig(raw), 200.0)
    zero_ns = int(raw.streams["/leg/telemetry"]["host_ns"][0])
    turning = data["q1_rad"] > 0.05
    # the emulated world began when the bench was made, at 1 s of virtual time
    truth = 0.4 * (data.time_s[turning] + zero_ns * 1e-9 - 1.0 - 0.3)
    late_s = (truth - data["q1_rad"][turning]).mean() / 0.4
    assert abs(late_s) < data.clock_bound_s and 1e-4 < data.clock_bound_s < 1e-3


@pytest.mark.parametrize("part, name, value, line", [
    ("pivot", "status", 0, "limit q1_rad tripped: pivot angle in rad cannot be checked"),
    ("pivot", "fail", (121, 9), "AS5600 at 0x36: no acknowledge; check wiring"),
    ("pivot", "brown_out", (), "AS5600 at 0x36: register CONF reads 0x0000 after 0x0300"),
    ("pivot", "held_at", 0, "AS5600 at 0x36: register CONF|limit q1_rad tripped"),
    ("pivot", "held_at", 255, "AS5600 at 0x36: register CONF|limit q1_rad tripped"),
    ("shunt", "fail", (121, 9), "INA228 at 0x40: no acknowledge; check wiring"),
    ("shunt", "brown_out", (), "INA228 at 0x40: register 0x01 reads 0xFB68 after"),
    ("shunt", "converting", False, STALE), ("", "_per_a", 0.001, STALE),
], ids=["magnet lost", "pivot silent", "pivot reset", "pivot lines low", "pivot lines open", "shunt silent",
        "shunt reset", "shunt stopped", "shunt overflow"])
def test_every_fault_ends_the_run_with_the_torque_off(path: Path, part: str, name: str, value: Any, line: str) -> None:
    """A value that something in the rig takes, or a call that it gets."""
    bench, struck = SensorBench(path), []
    owner = getattr(bench.mock, part) if part else bench.mock

    def strike() -> None:
        struck.append(bench.clock.now_ns())
        getattr(owner, name)(*value) if isinstance(value, tuple) else setattr(owner, name, value)

    said, raw = bench.fails(on_progress=at(0.25, strike))
    assert any(part in said for part in line.split("|")), said
    t_ns, asked, _ = bench.firmware.record
    assert t_ns[asked != 0.0][-1] - struck[0] < 0.125e9
    assert raw.events[-1].kind.startswith(("limit", "abort")) and raw.streams["/pivot"].size > 200


def test_a_glitch_on_the_bus_is_borne(path: Path) -> None:
    bench = SensorBench(path)
    bench.record(on_progress=at(0.25, lambda: (bench.mock.pivot.fail(121, 3), bench.mock.shunt.fail(5, 3))))
    assert [event.kind for event in read_run(bench.path).events] == ["start", "stop"]


def test_the_limit_of_the_pivot_goes_by_its_sensor(path: Path) -> None:
    bench = SensorBench(path, Turning(1.2, 0.8, joint=1), imu=False)
    bench.firmware.pivot_hall_ok = False  # without a sensor of its own that would be the end already
    said, _ = bench.fails(limits="q1_rad = 0.5\n")
    assert "limit q1_rad tripped: pivot angle in rad is 0.5" in said


def test_a_pivot_sensor_that_disagrees_with_the_gyro_fails_its_check() -> None:
    """Its shaft has come loose: the gyro turns, the sensor does not."""
    for loose in (False, True):
        plausible = Plausibility(Limits(), Calibration(), Hello(1, 1, 500, 50.0, 2.0, 1000), 238.0, 0)
        turned, failed_s = 0.0, 0.0
        rng = np.random.default_rng(1)
        for k in range(600):
            if k == 150:
                plausible.arm(1e-3)
            t_ns, speed = k * 10_000_000, (k > 200) * 1.0
            turned += 0.01 * speed
            plausible.pivot(t_ns, 0.0 if loose else turned + 7e-4 * rng.standard_normal())
            raw = rng.integers(-5, 5, (2, 6)).astype(np.int16)
            plausible.batch(raw, turned, t_ns + 1_000_000, False)
            failed_s = max(failed_s, plausible.suspects(t_ns).pivot_s or 0.0)
        assert (failed_s > 0.03) is loose


def test_tables_of_the_rig_file() -> None:
    rig = parse_rig(RIG.replace("[limits]\n", TABLES))
    pivot = rig.devices.pivot
    assert (pivot.sign, pivot.address, rig.devices.shunt.kind, rig.calibration.pivot_zero_rad) == (
        -1, 0x36, "ina228", 0.4)
