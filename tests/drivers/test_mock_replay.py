"""A recording played back as devices gives the recording again."""

import math
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from drivers.leg_controller import LegController
from drivers.lsm9ds1 import Lsm9ds1
from drivers.mock.clock import VirtualClock
from drivers.mock.imu_times import latch_times
from drivers.mock.link import EmulatorLink
from drivers.mock.replay import AXES, ReplayRig
from drivers.mock.rig import MockRig
from drivers.mock.settings import FirmwareSettings
from drivers.protocol import Hello, Pong, Telemetry


class Swing:
    """q1 = 0.5*sin(3t), q2 = cos(2t)."""

    def __init__(self) -> None:
        self.t = 0.0

    def step(self, dt_s: float, torque_nm: float) -> SimpleNamespace:
        self.t += dt_s
        t = self.t
        return SimpleNamespace(q1=0.5 * math.sin(3 * t), q2=math.cos(2 * t), q1d=1.5 * math.cos(3 * t),
                               q2d=-2 * math.sin(2 * t), q1dd=-4.5 * math.sin(3 * t))


class Recording(NamedTuple):
    telemetry: dict
    imu: dict
    probes: dict
    hello: Hello


def record(rig: MockRig | ReplayRig, link: EmulatorLink, until_ns: int | None = None, stall_at_s: float = 1e9,
           reboot_at_s: float = 1e9) -> Recording:
    """What a recorder does, at its smallest: poll, drain every 10 ms, ping at 4 Hz."""
    clock = rig.clock
    imu = Lsm9ds1(rig.imu, now_ns=clock.now_ns, sleep=clock.sleep)
    controller = LegController(link, clock.now_ns)
    imu.open()
    hello = controller.open()
    start = clock.now_ns()
    until_ns = until_ns or start + 4_000_000_000
    telemetry, samples, probes, asked = [], [], [], {}
    next_drain, next_ping = start, start
    boot_id = hello.boot_id
    while clock.now_ns() < until_ns:
        for message, host_ns in controller.poll():
            if isinstance(message, Hello):
                boot_id = message.boot_id
            elif isinstance(message, Telemetry):
                telemetry.append({"host_ns": host_ns, "boot_id": boot_id, **vars(message)})
            elif isinstance(message, Pong):
                probes.append((asked[message.ping_id], host_ns, message.rx_tick_us, message.tx_tick_us))
        now = clock.now_ns()
        if now >= next_drain:
            next_drain = now + 10_000_000
            if now - start > stall_at_s * 1e9:
                clock.sleep(0.3)
                stall_at_s = 1e9
            batch = imu.drain()
            samples += [(batch.t_before_ns, batch.t_after_ns, batch.gap_before and i == 0, *row)
                        for i, row in enumerate(batch.raw.tolist())]
        if now >= next_ping:
            next_ping = now + 250_000_000
            ping_id, tx_ns = controller.ping()
            asked[ping_id] = tx_ns
        if now - start > reboot_at_s * 1e9:
            rig.firmware.reboot()
            reboot_at_s = 1e9
    return Recording(
        {name: np.array([row[name] for row in telemetry]) for name in telemetry[0]},
        dict(zip(["drain_before_ns", "drain_after_ns", "gap_before", *AXES], np.array(samples).T)),
        dict(zip(["host_tx_ns", "host_rx_ns", "rx_tick_us", "tx_tick_us"], np.array(probes).T)), hello)


def original(**events: float) -> Recording:
    clock = VirtualClock(5_000_000_000)
    rig = MockRig(Swing(), clock, firmware=FirmwareSettings(first_tick_us=2**32 - 2_000_000), seed=3)
    return record(rig, EmulatorLink(rig.firmware, clock, seed=4), **events)


def replayed(run: Recording) -> Recording:
    rig = ReplayRig(run.telemetry, run.imu, run.probes, run.hello)
    return record(rig, EmulatorLink(rig.firmware, rig.clock, delay_s=0.0, jitter_s=0.0), rig.end_ns + 12_000_000)


@pytest.fixture(scope="module")
def run() -> Recording:
    return original()


@pytest.fixture(scope="module")
def again(run: Recording) -> Recording:
    return replayed(run)


def test_frames_and_their_host_times_come_back(run: Recording, again: Recording) -> None:
    for name, values in run.telemetry.items():
        if name != "host_ns":
            assert np.array_equal(again.telemetry[name], values, equal_nan=True), name
    assert np.abs(again.telemetry["host_ns"] - run.telemetry["host_ns"]).max() < 2_000_000


def test_samples_come_back_raw(run: Recording, again: Recording) -> None:
    n = min(len(run.imu["gyro_z"]), len(again.imu["gyro_z"]))
    assert n >= len(run.imu["gyro_z"]) - 3  # the last drain may fall behind the end
    for axis in AXES:
        assert np.array_equal(run.imu[axis][:n], again.imu[axis][:n])
    assert not again.imu["gap_before"].any()


def test_sample_times_come_back(run: Recording, again: Recording) -> None:
    times = [latch_times(r.imu["drain_before_ns"], r.imu["drain_after_ns"], r.imu["gap_before"] != 0, 1e9 / 238)
             for r in (run, again)]
    n = min(map(len, times))
    assert np.abs(times[0][:n] - times[1][:n]).max() < 150_000


def offset_us(probes: dict) -> np.ndarray:
    host = (probes["host_tx_ns"] + probes["host_rx_ns"]) / 2000
    tick = np.unwrap((probes["rx_tick_us"] + (probes["tx_tick_us"] - probes["rx_tick_us"]) % 2**32 / 2), period=2**32)
    return np.polynomial.Polynomial.fit(host, tick - host, 1)


def test_clock_probes_come_back(run: Recording, again: Recording) -> None:
    middle = run.telemetry["host_ns"].mean() / 1000
    assert len(again.probes["host_tx_ns"]) == pytest.approx(len(run.probes["host_tx_ns"]), abs=1)
    assert offset_us(again.probes)(middle) == pytest.approx(offset_us(run.probes)(middle), abs=60)


def test_gaps_come_back() -> None:
    run = original(stall_at_s=2.0)
    again = replayed(run)
    assert run.imu["gap_before"].sum() == 1
    assert np.flatnonzero(again.imu["gap_before"]).tolist() == np.flatnonzero(run.imu["gap_before"]).tolist()
    assert np.array_equal(run.imu["accel_x"][:800], again.imu["accel_x"][:800])


def test_reboots_come_back() -> None:
    run = original(reboot_at_s=1.0)
    again = replayed(run)
    assert len(set(run.telemetry["boot_id"].tolist())) == 2
    assert np.array_equal(run.telemetry["boot_id"], again.telemetry["boot_id"])


def test_latch_times_recover_a_clock_that_is_known() -> None:
    rng = np.random.default_rng(5)
    latched = 10**12 + 1_234_567 + np.arange(3000) * 4_100_000.0
    drains = 10**12 + np.cumsum(rng.uniform(8e6, 15e6, 2000))
    drain = np.searchsorted(drains, latched)
    whole = drain < drain[-1]  # the last drain would have found more
    drain, latched = drain[whole], latched[whole]
    before, after = drains[drain].astype(np.int64), (drains[drain] + 90_000).astype(np.int64)
    gap = np.zeros(len(latched), bool)
    assert np.abs(latch_times(before, after, gap, 1e9 / 238) - latched).max() < 60_000
    gap[np.flatnonzero(np.diff(drain))[700] + 1] = True
    assert np.abs(latch_times(before, after, gap, 1e9 / 238) - latched).max() < 120_000


def test_latch_times_of_single_drains_are_within_their_bounds() -> None:
    before, after = np.array([10**9, 10**9 + 20_000_000]), np.array([10**9 + 100_000, 10**9 + 20_100_000])
    times = latch_times(before, after, np.array([False, True]), 4_000_000.0)
    assert ((times <= after) & (times >= before - 4_400_000)).all()
