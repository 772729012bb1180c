"""What IMUs on any link read, against MuJoCo's sensors; and the joints' motion found back from them."""

import mujoco
import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import mark, raises

from estimator import FitError, FitOptions
from estimator.model import ImuPlace, biped3, chain, leg2
from estimator.signals import (
    accelerometer_at,
    accelerometer_slopes,
    differentiate,
    predicted_columns,
    sight,
    split_signals,
)
from tests.support.mujoco_tree import FRICTION_RADPS, Sensor, disturbed, imu_names, move, random_tree, torques

CASES = {
    "leg": ((-1, 0), leg2(velocity_scale=FRICTION_RADPS), [Sensor(1, 0.2), Sensor(0, 0.1)]),
    "chain": ((-1, 0, 1, 2), chain(4, velocity_scale=FRICTION_RADPS),
              [Sensor(3, 0.1), Sensor(1, 0.05), Sensor(2, 0.2)]),
    "walker": ((-1, 0, 0), biped3(gravity_mps2=9.81), [Sensor(2, 0.1), Sensor(1, 0.3), Sensor(0, 0.2)]),
}


@mark.parametrize("name", CASES)
def test_readings_are_those_of_mujoco(name: str) -> None:
    """To rounding, accelerations by the equation of motion with the plant's own parameters."""
    parent, mechanism, sensors = CASES[name]
    upright, rng = name == "walker", default_rng(1)
    friction = {} if not upright else {"viscous": 0.0, "coulomb": 0.0}
    tree = random_tree(rng, parent, upright=upright, **friction)
    mechanism = mechanism.with_imus(tuple(ImuPlace(*s) for s in sensors), tuple(tree.length))
    start = list(0.5 * rng.normal(size=tree.n)), list(rng.normal(size=tree.n))
    motion = move(tree, torques(tree, rng, 0.5, 250.0, 0.35, range(1, tree.n)), 250.0, sensors, start)
    qdd = mechanism.forward_dynamics(motion.q, motion.qd, motion.tau, tree.beta(mechanism))
    read = predicted_columns(mechanism, motion.q, motion.qd, qdd)
    for k in range(len(sensors)):
        for column, known in zip(imu_names(k), motion.imu[:, k].T):
            assert_allclose(read[column], known, rtol=0.0, atol=1e-11 * np.abs(known).max())
    assert np.abs(motion.imu[:, :, 1:]).max() > 9.0 and mujoco.__version__


@mark.parametrize("name", CASES)
def test_slopes_are_the_readings_own(name: str) -> None:
    _, mechanism, sensors = CASES[name]
    mechanism = mechanism.with_imus(tuple(ImuPlace(*s) for s in sensors), (0.3, 0.4, 0.2, 0.1))
    rng = default_rng(2)
    motion, h = rng.normal(size=(3, mechanism.n, 5)), 1e-6
    for place in mechanism.imus:
        felt, *slopes = accelerometer_slopes(mechanism, place, *motion)
        assert_allclose(felt, accelerometer_at(mechanism, place, *motion), atol=1e-13)
        angle = mechanism.transform[place.link] @ motion[0]
        for one, other in zip(accelerometer_slopes(mechanism, place, *motion, turned=(np.cos(angle), np.sin(angle))),
                              (felt, *slopes)):
            assert_allclose(one, other, atol=1e-13)
        for which, slope in enumerate(slopes):
            for j in range(mechanism.n):
                up, down = motion.copy(), motion.copy()
                up[which, j] += h
                down[which, j] -= h
                numeric = (np.stack(accelerometer_at(mechanism, place, *up))
                           - np.stack(accelerometer_at(mechanism, place, *down))) / (2.0 * h)
                assert_allclose(slope[:, j], numeric, atol=1e-7)


@mark.parametrize("links, sensors, encoders", [
    (2, [Sensor(1, 0.1)], (1,)), (2, [Sensor(0, 0.2), Sensor(1, 0.1)], ()), (3, [Sensor(2, 0.1)], (1, 2)),
    (7, [Sensor(0, 0.1), Sensor(3, 0.1), Sensor(6, 0.1)], (1, 2, 4, 5)), (7, [Sensor(k, 0.1) for k in range(7)], ())])
def test_a_fit_starts_near_the_motion(links: int, sensors: list[Sensor], encoders: tuple[int, ...]) -> None:
    """A gyro with a bias, and links that accelerate by several g."""
    rng = default_rng(3)
    tree = random_tree(rng, range(-1, links - 1))
    mechanism = (leg2() if links == 2 else chain(links)).with_imus(
        tuple(ImuPlace(*s) for s in sensors), tuple(tree.length))
    motion = move(tree, torques(tree, rng, 5.0, 250.0, 0.5, range(1, links)), 250.0, sensors)
    data = disturbed(motion, range(1, links), 250.0, rng)
    data.columns["gyro_radps"][:] += 0.01
    options = FitOptions(sensors="imu", encoders=encoders)
    (signals,) = split_signals([data], mechanism, options)
    found = differentiate(signals, mechanism, 2.0 * options.cutoff(250.0), 4, fused=True)
    error = (found.q - motion.q + np.pi) % (2.0 * np.pi) - np.pi
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.01


def test_joints_that_nothing_shows_are_named() -> None:
    three = chain(3).with_imus((ImuPlace(2, 0.1), ImuPlace(1, 0.1)), (0.3, 0.3))
    with raises(FitError, match="angles of joints 1 and 2 apart: with 1 encoder and 2 IMUs 1 of 3 angles"):
        sight(three, (2,), True)
    with raises(FitError, match="angle of joint 1: with 2 encoders and 0 IMUs"):
        sight(three, (1, 2), False)
    shown = sight(three, (1,), True)
    assert shown.encoders == (1,) and shown.imus == (1, 0)


def test_an_imu_needs_the_lengths_it_rides_on() -> None:
    with raises(ValueError, match="IMU 2 on link 3 rides on link 2, whose length is not given"):
        chain(3).with_imus((ImuPlace(0, 0.1), ImuPlace(2, 0.1)), (0.3,))
    with raises(ValueError, match="IMU 1 is on link 3, leg2 has 2"):
        leg2().with_imus((ImuPlace(2, 0.1),), (0.3, 0.3))
    assert biped3().with_imus((ImuPlace(2, 0.1),), (0.7,)).joints_to(2) == (0, 2)
    with raises(ValueError, match="hips change places has no IMUs"):
        biped3(hips=True).with_imus((ImuPlace(2, 0.1),), (0.7,))
