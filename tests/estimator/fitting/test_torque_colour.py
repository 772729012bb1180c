"""What a right model leaves in a torque residual, against the dense covariance of a smoother's residual."""

import numpy as np
from pytest import approx, mark

from estimator import FitOptions
from estimator.fitting.excerpt import excerpt
from estimator.fitting.torque_colour import torque_colour
from estimator.likelihood import LatentProblem, Noise
from estimator.model import leg2
from estimator.signals import split_signals
from tests.support.dense_chain import at_measured, residual_colour
from tests.support.mujoco_leg import Leg, record

SMOOTH = Leg(coulomb=(0.0, 0.0))


@mark.parametrize("sensors", ["imu", "encoder"])
def test_it_is_that_of_the_residual_s_covariance(sensors: str) -> None:
    mechanism = leg2(lever_arm=SMOOTH.lever)
    data = record(SMOOTH, np.random.default_rng(9), rate_hz=100.0, seconds=6.0)
    signals = split_signals([data], mechanism, FitOptions(sensors=sensors))
    problem = LatentProblem(signals, mechanism, "zero")
    with_imu = sensors == "imu"
    noise = Noise(np.array([0.001, 0.01]), np.array([np.inf if with_imu else 3e-4, 3e-4]),
                  *((np.array([0.005]), np.full((1, 2), 0.2)) if with_imu else ()))
    state = at_measured(problem, data, SMOOTH.beta(), noise)
    found, wanted = torque_colour(problem, state, signals), residual_colour(problem, state, 0.01)
    assert found[1] == approx(wanted, abs=0.06) and not found[0].any()
    assert (wanted[0] > 0.5) == (sensors == "encoder")  # an accelerometer shows the torque at once


def test_an_excerpt_is_the_first_part_of_each_segment() -> None:
    mechanism, rng = leg2(), np.random.default_rng(2)
    runs = [record(SMOOTH, rng, rate_hz=100.0, seconds=seconds, name=f"r{k}") for k, seconds in enumerate((6.0, 12.0))]
    signals = split_signals(runs, mechanism, FitOptions(sensors="encoder"))
    parts, where = excerpt(signals, 600)
    first, second = (len(one.time_s) for one in parts)
    assert second == approx(2 * first, abs=2) and first + second == approx(600, abs=2)
    whole = np.concatenate([one.angles for one in signals])
    np.testing.assert_array_equal(np.concatenate([one.angles for one in parts]), whole[where])
