"""Set-ups of records that begin with an impact or a torque step are recognised as those of quiet records are.

The legs are those of the blind study: an integrator of its own, friction as a set-valued force.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pytest import fixture, mark

from daq import Dataset
from estimator import FitOptions
from estimator.calibration.windows import CLEAR
from estimator.model import leg2
from evidence.blind.excite import draw
from evidence.blind.leg import GRAVITY, Array, Leg, stack
from evidence.blind.measure import RATE_HZ, Sensors, disturb, imu
from evidence.blind.physics import integrate
from evidence.emulated_legs import SPREAD
from experiments.session import Suspicion, suspect

SECONDS, LEVER_M = 10.0, 0.2
IMU = ("gyro_radps", "accel_x_mps2", "accel_y_mps2")


@dataclass(frozen=True)
class Start:
    """How a record begins."""

    torque_nm: float = 0.0
    """More than the plan's, in the first 50 ms."""
    knee: tuple[float, float] = (0.0, 0.0)
    """Angle [rad] and rate [rad/s]."""
    stop_rad: float = 50.0
    """Angle of the knee at a hard stop."""


STARTS = {"quiet": Start(), "step": Start(torque_nm=8.0), "stop": Start(knee=(1.9, 15.0), stop_rad=2.0)}
SEEDS = (1, 2)


@fixture(scope="module")
def records() -> dict[tuple[str, int], Dataset]:
    """One run of each start and seed, all integrated at once."""
    cases = [(name, seed) for name in STARTS for seed in SEEDS]
    rngs = [np.random.default_rng(seed) for _, seed in cases]
    starts = [STARTS[name] for name, _ in cases]
    time = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    legs, torques = [], []
    for rng, start in zip(rngs, starts):
        f = np.exp(SPREAD * rng.standard_normal(6))
        plain = Leg()
        legs.append(replace(plain, m1=plain.m1 * f[0], i1=plain.i1 * f[1], m2=plain.m2 * f[2], i2=plain.i2 * f[3],
                            viscous2=plain.viscous2 * f[4], coulomb2=plain.coulomb2 * f[5]))
        torques.append(draw(rng, "big").at(time) + start.torque_nm * (time < 0.05))
    knees = np.array([start.knee for start in starts]).T
    stops: dict[str, Array | float] = {
        "stop_angle": np.array([start.stop_rad for start in starts]), "stop_stiffness": 5000.0, "stop_damping": 0.3,
        "stop_side": 1.0}
    motion = integrate(stack(legs), np.stack(torques, axis=1), extra=stops, step=1e-3,
                       start=np.stack([np.zeros(len(cases)), knees[0], np.zeros(len(cases)), knees[1]]))
    found, sensors = {}, Sensors()
    for lane, (case, rng) in enumerate(zip(cases, rngs)):
        still = np.zeros_like(time)
        gyro, ax, ay = imu(motion.q1[:, lane], motion.w1[:, lane], motion.a1[:, lane], still, still, LEVER_M)
        clean = {"q2_rad": motion.q2[:, lane], "tau2_nm": torques[lane], "gyro_radps": gyro, "accel_x_mps2": ax,
                 "accel_y_mps2": ay}
        noisy = disturb(clean, sensors.torque * rng.standard_normal(time.size), sensors, rng)
        found[case] = Dataset("run.csv", RATE_HZ, time, noisy)
    return found


def times(factor: float, *columns: str) -> Callable[[Dataset], Dataset]:
    return lambda run: replace(run, columns={**run.columns, **{c: factor * run[c] for c in columns}})


def late(samples: int, *columns: str) -> Callable[[Dataset], Dataset]:
    return lambda run: replace(run, columns={**run.columns, **{
        c: np.concatenate([np.full(samples, run[c][0]), run[c][:-samples]]) for c in columns}})


def told(run: Dataset, lever_arm: float, suspected: bool = True) -> Suspicion:
    return suspect([run], leg2(gravity_mps2=GRAVITY, lever_arm=lever_arm), FitOptions(sensors="imu"), 1.0, suspected)


@mark.parametrize("seed", SEEDS)
@mark.parametrize("start", STARTS)
def test_a_right_set_up_is_not_suspected(start: str, seed: int, records: dict[tuple[str, int], Dataset]) -> None:
    for suspected in (False, True):
        assert told(records[start, seed], LEVER_M, suspected) == Suspicion()


@mark.parametrize("spoil, lever_arm, named", [
    (times(-1.0, "tau2_nm"), LEVER_M, "tau2_nm looks negated: "),
    (times(180.0 / np.pi, "q2_rad"), LEVER_M, "q2_rad looks in degrees: "),
    (times(1.0, "q2_rad"), 1.5 * LEVER_M, "the IMU looks 0.2 m from the pivot, not 0.3: "),
    (times(1.0, "q2_rad"), LEVER_M / 1.5, "the IMU looks 0.2 m from the pivot, not 0.13: "),
    (times(-1.0, "gyro_radps"), LEVER_M, "gyro_radps looks negated: "),
    (times(-1.0, *IMU[1:]), LEVER_M, "accel_x_mps2 and accel_y_mps2 look negated: "),
])
@mark.parametrize("start", STARTS)
def test_a_wrong_set_up_is_named_however_the_record_begins(
        start: str, spoil: Callable[[Dataset], Dataset], lever_arm: float, named: str,
        records: dict[tuple[str, int], Dataset]) -> None:
    for seed in SEEDS:
        seen = told(spoil(records[start, seed]), lever_arm)
        assert seen.remedies[0].startswith(named)
        assert "; with it " in seen.remedies[0]


@mark.parametrize("start", STARTS)
def test_late_samples_are_no_other_reading(start: str, records: dict[tuple[str, int], Dataset]) -> None:
    for spoil in (late(3, "tau2_nm"), late(3, *IMU)):
        assert told(spoil(records[start, SEEDS[1]]), LEVER_M).remedies == ()


def test_a_wrong_lever_arm_hides_no_wrong_torque(records: dict[tuple[str, int], Dataset]) -> None:
    (text,) = told(times(-1.0, "tau2_nm")(records["step", SEEDS[0]]), 1.5 * LEVER_M).remedies
    assert "the IMU looks 0.2 m from the pivot" in text and "tau2_nm looks negated" in text


def test_a_remedy_tells_what_it_gains(records: dict[tuple[str, int], Dataset]) -> None:
    (text,) = told(times(180.0 / np.pi, "q2_rad")(records["step", SEEDS[0]]), LEVER_M).remedies
    before, after = text.split("falls from ")[1].removesuffix(" of the torque").split(" to ")
    assert CLEAR * float(after.removesuffix(" %")) < float(before.removesuffix(" %"))
