"""Each check of what devices say: silent while it is true, however dull, and in time when it cannot be."""

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from daq import Calibration, Limits
from daq.recording.plausibility import Plausibility, SuspectTimes, TwoAngles
from drivers import Hello, Telemetry

HZ, IMU_HZ = 500, 238.0
HELLO = Hello(1, 7, HZ, 50.0, 2.0, 1000)
LIMITS = Limits()
FRAME = Telemetry(0, 0, 1, 0, 0.2, 0.1, 0.2, 0.0, 24.0, 30.0, 0.0)


def frames(seconds: float, torque=lambda t: 0.0, knee=lambda t: 0.2) -> Iterator[tuple[Telemetry, int]]:
    """Telemetry of a true leg with noise, over wraps of sequence and tick."""
    rng = np.random.default_rng(0)
    for k in range(round(seconds * HZ)):
        t = k / HZ
        yield replace(FRAME, seq=(65_500 + k) % 65_536, tick_us=(2**32 - 90_000 + 2000 * k) % 2**32,
                      knee_rad=knee(t), knee_hall_rad=knee(t) + 1.0 + 0.003 * rng.standard_normal(),
                      current_a=torque(t - 0.002) + 0.02 * rng.standard_normal(),
                      torque_cmd_nm=torque(t)), round(1e9 + t * 1e9 + 2e5 * rng.exponential())


def flagged(seconds: float, lie=lambda t, frame: frame, torque=lambda t: 0.0, knee=lambda t: 0.2) -> tuple[str, float]:
    """(first check beyond its time-out, when it was [s]), or ("", end)."""
    checks = Plausibility(LIMITS, Calibration(), HELLO, None, 10**9)
    bounds = {"controller_age_s": LIMITS.staleness_s, "echo_s": LIMITS.echo_s, "torque_s": LIMITS.torque_s,
              "encoder_s": LIMITS.encoder_s}
    for frame, ns in frames(seconds, torque, knee):
        t = (ns - 10**9) * 1e-9
        checks.commanded(ns - 1_000_000, frame.torque_cmd_nm)
        told = lie(t, frame)
        if told is not None:
            checks.frame(told, ns)
        found = checks.suspects(ns)._asdict()
        for name, bound in bounds.items():
            if (found[name] or 0.0) > bound:
                return name, t
    return "", seconds


def swing(t: float) -> float:
    return 0.6 * math.sin(8 * t)


@pytest.mark.parametrize("torque, knee", [
    (lambda t: 0.0, lambda t: 0.2),  # zero plan, standing leg: nothing changes but noise
    (lambda t: 0.05, lambda t: 0.2),  # a slow plan against friction
    (swing, lambda t: 1.2 * math.sin(8 * t)), (lambda t: 1.5 if t % 1.0 > 0.5 else -1.5, lambda t: 0.5 * t)])
def test_a_true_leg_is_believed(torque, knee) -> None:
    assert flagged(4.0, torque=torque, knee=knee) == ("", 4.0)


def test_losses_doubles_and_late_frames_are_believed() -> None:
    kept = []

    def bad_wire(t: float, frame: Telemetry) -> Telemetry | None:
        kept.append(frame)
        return None if frame.seq % 7 == 0 else kept[-2] if frame.seq % 11 == 0 and len(kept) > 1 else frame

    assert flagged(3.0, bad_wire, torque=swing, knee=swing) == ("", 3.0)


STRUCK_S = 1.0
LIES: list[tuple[str, str, Callable[[float, float], float], float]] = [
    ("controller_age_s", "seq", lambda now, then: then, 0.11),
    ("controller_age_s", "tick_us", lambda now, then: then, 0.11),
    ("echo_s", "torque_cmd_nm", lambda now, then: now + 1.5, 0.06),
    ("torque_s", "current_a", lambda now, then: 0.0, 0.11), ("torque_s", "current_a", lambda now, then: -now, 0.11),
    ("torque_s", "current_a", lambda now, then: then, 0.11),
    ("torque_s", "current_a", lambda now, then: now + 1.0, 0.08),
    ("encoder_s", "knee_rad", lambda now, then: then, 0.09),
    ("encoder_s", "knee_hall_rad", lambda now, then: then, 0.09)]
"""A field, and what it reads instead of what it reads now; `then` is what it read as the lie began."""


def flagged_since_struck(lie: Callable[[Telemetry, Telemetry], Telemetry]) -> tuple[str, float]:
    """The check that flags a lie about a driven swing, and after how long [s]."""
    then = []

    def told(t: float, frame: Telemetry) -> Telemetry:
        if t < STRUCK_S:
            return frame
        then.append(frame)
        return lie(frame, then[0])

    name, at_s = flagged(3.0, told, torque=swing, knee=swing)
    return name, at_s - STRUCK_S


@pytest.mark.parametrize("check, field, lie, within_s", LIES)
def test_impossible_readings_are_flagged_in_time(check: str, field: str, lie: Callable[[float, float], float],
                                                 within_s: float) -> None:
    def told(now: Telemetry, then: Telemetry) -> Telemetry:
        changed: Any = {field: lie(getattr(now, field), getattr(then, field))}
        return replace(now, **changed)

    name, after_s = flagged_since_struck(told)
    assert name == check and after_s < within_s


def test_a_frame_that_is_repeated_is_flagged_in_time() -> None:
    name, after_s = flagged_since_struck(lambda now, then: then)
    assert name == "controller_age_s" and after_s < 0.11


def test_a_dead_shunt_shows_under_a_gentle_plan_too() -> None:
    name, at_s = flagged(3.0, lambda t, f: replace(f, current_a=0.0), torque=lambda t: 0.16 * math.sin(3 * t))
    assert name == "torque_s" and at_s < 1.0


def test_a_controller_whose_clock_runs_at_half_speed_falls_behind() -> None:
    sent = itertools.count()

    def slow(t: float, frame: Telemetry) -> Telemetry | None:
        return None if round(t * HZ) % 2 else replace(frame, seq=(k := next(sent)), tick_us=2000 * k)

    name, at_s = flagged(3.0, slow)
    assert name == "controller_age_s" and at_s < 0.3


def imu_suspects(rows: np.ndarray, turned=lambda t: 0.0, hall=lambda t: 0.1) -> SuspectTimes:
    """After all samples, in drains of five, beside telemetry with the pivot's Hall angle; armed at once."""
    checks = Plausibility(LIMITS, Calibration(), HELLO, IMU_HZ, 0)
    checks.arm()
    for k in range(0, len(rows), 5):
        t = k / IMU_HZ
        ns = round(t * 1e9)
        checks.frame(replace(FRAME, seq=k % 65536, tick_us=2000 * k, pivot_hall_rad=hall(t)), ns)
        checks.batch(rows[k:k + 5].astype(np.int16), turned(t), ns, False)
    return checks.suspects(ns)


def noise(n: int = 200) -> np.ndarray:
    return np.rint(np.random.default_rng(1).normal(0, 3, (n, 6)))


def test_an_imu_at_rest_is_believed_by_its_noise_and_one_that_repeats_itself_is_not() -> None:
    assert imu_suspects(noise())[-3:] == (0.0, 0.0, 0.0)
    for part in (slice(0, 6), slice(0, 3), slice(3, 6)):
        stuck = noise()
        stuck[150:, part] = stuck[150, part]
        assert imu_suspects(stuck).imu_stuck_s == pytest.approx(49 / IMU_HZ)
    for word in (0, -1):
        dead = noise()
        dead[100:] = word
        assert (imu_suspects(dead).imu_stuck_s or 0.0) > LIMITS.imu_stuck_s


def test_rails_are_counted_and_an_impact_is_not_a_rail() -> None:
    for rows, axis, word, lasted_s in ((slice(170, 200), 2, 32767, 30 / IMU_HZ), (slice(100, 104), 4, -32768, 0.0)):
        railed = noise()
        railed[rows, axis] = word
        assert imu_suspects(railed).imu_rail_s == pytest.approx(lasted_s)


def test_gyro_and_hall_of_the_pivot_must_turn_alike() -> None:
    def q1(t: float) -> float:
        return 0.5 * math.sin(5 * t)

    assert imu_suspects(noise(), q1, q1).pivot_s == 0.0
    assert (imu_suspects(noise(), q1, lambda t: 0.1).pivot_s or 0.0) > 0.0
    assert (imu_suspects(noise(), lambda t: -q1(t), q1).pivot_s or 0.0) > 0.0
    assert imu_suspects(noise(), q1, lambda t: math.nan).pivot_s == 0.0


def angles_apart(first: Callable[[float], float], second: Callable[[float], float], seconds: float = 1.0) -> float:
    """When two angles [rad] were first in doubt for 20 ms [s]; `seconds` if they never were."""
    both = TwoAngles(0.04)
    for t in np.arange(0.0, seconds, 0.002).tolist():
        both.see(t, first(t), second(t))
        if both.wrong.lasted_s > 0.02:
            return t
    return seconds


def test_a_stuck_angle_shows_at_half_the_band_a_coarse_one_is_believed() -> None:
    """From rest, slowly: 0.02 rad are passed at 0.28 s, 0.04 rad within a quarter of a second at 0.46 s."""
    rng = np.random.default_rng(0)

    def slow(t: float) -> float:
        return 0.5 * 0.5 * t**2

    def noisy(t: float) -> float:
        return round((slow(t) + 0.002 * rng.standard_normal()) / 0.006) * 0.006

    def stuck(t: float) -> float:
        return noisy(t) if t < 0.1 else 0.006

    assert angles_apart(slow, noisy) == 1.0
    assert 0.28 < angles_apart(slow, stuck) < 0.31
    assert 0.46 < angles_apart(slow, lambda t: 0.006) < 0.50  # whose steps nobody has seen: the band decides
    def swing(t: float) -> float:
        return math.sin(3 * t)

    for counts in (256, 300, 500):
        def coarse(angle: Callable[[float], float], step: float = math.tau / counts) -> Callable[[float], float]:
            return lambda t: math.floor(angle(t) / step) * step

        assert angles_apart(swing, coarse(swing), 5.0) == 5.0
        assert angles_apart(lambda t: round(slow(t), 2), coarse(slow), 2.0) == 2.0
