"""What holds for every drive: stopped when it should be, its units, its watchdog, its faults, its time."""

import math
from typing import Any

import numpy as np
import pytest

from drivers import DeviceAbsent, DriverError, Hello, LinkLost, State, drive_kinds, open_drive
from drivers.can_frame import CanFrame
from drivers.errors import DeviceFault
from drivers.mock import drive_facts
from drivers.protocol import Fault
from tests.support.drive_bench import CONSTANT, DriveBench, driven, faults, opened, states, telemetry
from tests.support.still_plant import MovingPlant, StillPlant, StillState

NEVER_ON = ["feetech"]
"""Drives that legid reads and does not arm."""
KINDS = [kind for kind in drive_kinds() if kind not in ("legid", *NEVER_ON)]


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(params=[*KINDS, *NEVER_ON])
def any_kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_every_drive_has_an_emulator_and_says_what_it_lacks(any_kind: str) -> None:
    bench = DriveBench(any_kind)
    assert drive_facts(any_kind).rate_hz > 0 and bench.drive.capabilities.lacks
    assert all(lack.what and lack.instead for lack in bench.drive.capabilities.lacks)


@pytest.mark.parametrize("kind", NEVER_ON)
def test_a_drive_without_a_watchdog_never_turns(kind: str) -> None:
    bench = opened(kind)
    for _ in range(2):
        with pytest.raises(DeviceFault, match="has no watchdog, so a lost host would leave the torque on"):
            bench.drive.arm(100)
        bench.drive.command(1.0)
        bench.run(0.05, 1.0)
        assert not bench.far.record[1].any() and states(bench.run(0.02)) == {State.DISARMED}
        bench.drive.clear_faults()


def test_a_drive_that_nobody_knows_is_named_with_those_that_there_are() -> None:
    with pytest.raises(DeviceAbsent, match=r"no driver knows vesc; there are .*legid.*drivers/vesc_drive.py"):
        open_drive("vesc", DriveBench(KINDS[0]).wiring)


def test_angle_torque_and_current_are_the_joints(kind: str) -> None:
    bench = DriveBench(kind, StillPlant(StillState(q2=0.3)))
    hello = bench.drive.open()
    assert 2.0 <= hello.torque_limit_nm < 2.2 and hello.gear_ratio == 50.0
    bench.armed()
    bench.run(0.1, 0.6)
    seen = telemetry(bench.run(0.2, 0.6))
    assert states(bench.run(0.02, 0.6)) == {State.ARMED}
    last = seen[-1]
    assert last.knee_rad == pytest.approx(0.3, abs=2 * math.pi / 50 / 4096)
    assert last.torque_cmd_nm == pytest.approx(0.6, abs=1e-3) and last.bus_v == pytest.approx(24.0, abs=0.2)
    assert np.mean([t.current_a for t in seen]) * CONSTANT == pytest.approx(0.6, abs=0.02)
    assert bench.rig.drive.motor.last_mean_nm == pytest.approx(0.6, abs=1e-3)


def test_a_motor_that_turns_is_stopped_on_opening(kind: str) -> None:
    bench = driven(kind)
    assert bench.far.torque_nm != 0.0
    bench.attached().open()
    bench.alone(0.002)
    assert bench.far.torque_nm == 0.0


@pytest.mark.parametrize("way", ["stop", "close", "clear_faults"])
def test_nothing_turns_after(kind: str, way: str) -> None:
    bench = driven(kind)
    getattr(bench.drive, way)()
    if way != "close":
        bench.drive.command(1.0)  # from another thread, too late
        bench.run(0.03)
        assert not bench.drive.armed
    bench.alone(0.003)
    assert bench.far.torque_nm == 0.0


@pytest.mark.parametrize("torque", [2.5, -2.5, math.nan, math.inf])
def test_a_torque_beyond_the_limit_stops_the_motor(kind: str, torque: float) -> None:
    bench = driven(kind)
    with pytest.raises(DriverError, match=r"beyond its limit of 2"):
        bench.drive.command(torque)
    bench.run(0.02)
    assert bench.far.torque_nm == 0.0


@pytest.mark.parametrize("watchdog_ms", [50, 100, 300])
def test_the_drives_own_watchdog_ends_the_torque_of_a_host_that_is_gone(kind: str, watchdog_ms: int) -> None:
    """Polling goes on: only commands feed it."""
    bench = DriveBench(kind)
    bench.armed(watchdog_ms)
    bench.run(0.1, 1.0)
    bench.drive.command(1.0)
    gone_ns = bench.clock.now_ns()
    received = bench.run(watchdog_ms * 1e-3 + 0.15)
    assert 0.5e-3 * watchdog_ms < bench.zero_after(gone_ns) < 1e-3 * watchdog_ms + 0.01
    assert [fault.fault for fault in faults(received)] == [Fault.WATCHDOG] and State.FAULT in states(received)
    bench.drive.command(1.0)
    bench.run(0.02, 1.0)
    assert bench.far.torque_nm == 0.0
    with pytest.raises(DeviceFault, match=r"watchdog.*legid doctor --clear-faults"):
        bench.drive.arm(watchdog_ms)
    bench.drive.clear_faults()
    assert states(bench.run(0.05)) == {State.DISARMED}


def test_a_watchdogs_fault_of_a_run_before_is_still_there_on_opening(kind: str) -> None:
    bench = driven(kind, 100)
    bench.run(0.3)
    again = bench.attached()
    again.open()
    with pytest.raises(DeviceFault, match="watchdog"):
        again.arm(100)


def test_a_watchdog_out_of_range_is_refused(kind: str) -> None:
    bench = opened(kind)
    with pytest.raises(ValueError, match="outside 5 to"):
        bench.drive.arm(2)


def test_a_sample_was_taken_between_request_and_answer(any_kind: str) -> None:
    """The knee moves in a known way, so that each angle tells when it was read."""
    bench = opened(any_kind, MovingPlant(lambda t: StillState(q2=t, q2d=1.0)))
    began = bench.clock.now_ns()
    received = [one for one in bench.run(0.5) if telemetry([one])]
    assert len(received) > 0.45 * bench.wiring.rate_hz
    knee = np.array([t.knee_rad for t in telemetry(received)])
    asked, host = (np.array([getattr(one, name) for one in received]) for name in ("asked_ns", "host_ns"))
    taken = (knee - knee[0]) * 1e9 + asked[0]
    slack = 1e9 * 2 * math.pi / 50 / 16384 + 0.6e6  # a count of the encoder, a step of the physics
    assert began <= asked[0] and np.minimum(taken - asked, host - taken).min() > -slack
    ticks = np.array([t.tick_us for t in telemetry(received)])
    assert np.abs(ticks - (asked + host) / 2000 % 2**32).max() <= 1.0


def test_what_comes_too_late_is_no_answer_to_a_later_request(any_kind: str) -> None:
    bench = opened(any_kind)
    bench.run(0.05)
    true, held = bench.link.read, list[Any]()

    def slow() -> Any:
        data = true()
        if not data or held:
            return data
        held.append(data)
        return data[:0]

    bench.link.read = slow
    lost = bench.drive.stats.lost
    received = bench.run(0.1)
    assert bench.drive.stats.lost > lost
    waits = [one.host_ns - one.asked_ns for one in received if one.asked_ns is not None]
    assert waits and max(waits) < 5e6


def test_nobody_there_and_a_wrong_node_name_what_to_look_at(any_kind: str) -> None:
    bench = DriveBench(any_kind)
    bench.far.powered = False
    with pytest.raises(DeviceAbsent, match=r"no answer within 0.5 s; .*node"):
        bench.drive.open(0.5)
    with pytest.raises(DeviceAbsent, match="node"):
        DriveBench(any_kind).attached(node=9).open(0.5)


def test_a_drive_that_hangs_gives_no_telemetry(any_kind: str) -> None:
    bench = opened(any_kind)
    bench.far.alive = False
    bench.run(0.05)
    assert not telemetry(bench.run(0.2)) and bench.drive.stats.lost > 3


@pytest.mark.parametrize("kind, hang, least", [("dynamixel", "stuck", 5), ("moteus", "stuck_counter_ms", 50)])
def test_readings_that_stand_still_are_no_telemetry(kind: str, hang: str, least: int) -> None:
    """Its communication lives, its registers stand still: the tick or the counter shows it."""
    bench = opened(kind)
    assert telemetry(bench.run(0.1))
    setattr(bench.far, hang, 1)
    bench.run(0.02)
    assert not telemetry(bench.run(0.2)) and bench.drive.stats.bad_crc > least and bench.drive.stats.lost == 0


@pytest.mark.parametrize("kind", ["dynamixel", "moteus"])
def test_a_restart_on_the_way_is_told_and_the_torque_stays_off(kind: str) -> None:
    bench = DriveBench(kind)
    bench.clock.advance(20_000_000_000)  # moteus shows it by a counter that starts anew
    bench.armed(1000)
    bench.run(0.2, 1.0)
    before = bench.drive.hello
    bench.far.power_cycle()
    (hello,) = [one.message for one in bench.run(0.1, 1.0) if isinstance(one.message, Hello)]
    assert hello.boot_id != before.boot_id and bench.drive.stats.reboots == 1
    assert bench.far.torque_nm == 0.0 and not bench.drive.armed


def test_a_pulled_cable_is_said_and_the_watchdog_acts(kind: str) -> None:
    bench = driven(kind, 100)
    pulled_ns = bench.clock.now_ns()
    bench.link.unplug()
    with pytest.raises(LinkLost):
        bench.run(0.1)
    bench.alone(0.3)
    assert bench.zero_after(pulled_ns) < 0.11
    bench.drive.close()


@pytest.mark.parametrize("part, state, fault", [
    ("encoder_ok", False, Fault.KNEE_ENCODER),
    ("bus_v", 10.0, Fault.UNDERVOLTAGE),
    ("bus_v", 50.0, Fault.OVERVOLTAGE),
    ("degc", 120.0, Fault.OVERTEMPERATURE),
    ("driver_ok", False, Fault.GATE_DRIVER)])
def test_its_own_faults_have_our_names(kind: str, part: str, state: float, fault: Fault) -> None:
    bench = driven(kind)
    setattr(bench.far, part, state)
    since = bench.clock.now_ns()
    received = bench.run(0.1, 0.9)
    assert bench.zero_after(since) < 0.01 and bench.drive.telemetry is not None
    assert bench.drive.telemetry.faults == fault and State.FAULT in states(received) and bench.drive.words


def test_noise_on_the_line_is_counted_and_survived(any_kind: str) -> None:
    bench, rng = opened(any_kind), np.random.default_rng(3)
    true = bench.link.read

    def noisy() -> Any:
        data = true()
        if rng.random() < 0.3 and not isinstance(data, bytes):
            own = data[0].can_id if data else int(rng.integers(2048))
            data = (CanFrame(own, rng.bytes(int(rng.integers(9))), False, True), *data)
        return data

    bench.link.read = noisy
    assert len(telemetry(bench.run(1.0))) > 0.3 * bench.wiring.rate_hz
