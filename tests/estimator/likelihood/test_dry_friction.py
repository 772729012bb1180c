"""Friction near rest: its rounding found by the likelihood, and a passage that counts once."""

from dataclasses import replace

import numpy as np
import pytest

from daq import Dataset
from estimator import FitOptions, fit
from estimator.likelihood.dry_friction import crossing_samples, likeliest_smoothing
from estimator.model import leg2
from evidence.blind import servo
from tests.support.mujoco_leg import random_leg


def test_samples_of_one_zero_crossing_count_together() -> None:
    v = np.array([1.0, 0.01, -0.01, -1.0, 0.0, 0.0, 0.0, 1.0])
    np.testing.assert_array_equal(crossing_samples(v, 0.02, np.array([6, 8])), [1, 2, 2, 1, 2, 2, 1, 1])


def test_the_smoothing_velocity_is_no_larger_than_the_torque_shows() -> None:
    rng = np.random.default_rng(5)
    v, level, now = rng.normal(0.0, 0.4, 6000), 0.1, 0.02

    def found(true: float) -> float:
        made = level * v / np.sqrt(v * v + true**2) + rng.normal(0.0, 0.01, v.size)
        residual = level * v / np.sqrt(v * v + now**2) - made
        return likeliest_smoothing(v, level, 0.005, now, 0.01, residual, np.zeros_like(v))

    sharp, round_, flat = found(0.005), found(0.04), found(0.16)
    assert sharp == 0.005 < round_ < flat < 0.16


@pytest.mark.parametrize("rate_hz", [100, 500])
def test_another_engines_friction_is_inside_its_interval(rate_hz: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo takes a joint through rest over some hundredths of a rad/s, by its solver's time constant."""
    monkeypatch.setattr(servo, "RATE_HZ", float(rate_hz))
    rng = np.random.default_rng(6101)
    leg, dry = replace(random_leg(rng), coulomb=(0.0, 0.0)), 0.08
    columns = servo.record(leg, servo.Plant(), dry, rng, 0, 0.0)
    for name, sigma in servo.NOISE.items():
        columns[name] = columns[name] + sigma * rng.normal(size=columns[name].size)
    columns["q2_rad"] = columns["q2_rad"] + 2e-4 * rng.normal(size=columns["q2_rad"].size)
    run = Dataset("r1", float(rate_hz), columns["time_s"], columns)
    true = replace(leg, coulomb=(0.1 * dry, dry)).beta()
    mechanism = leg2(lever_arm=leg.lever)

    def scores(smoothing: str) -> np.ndarray:
        found = fit([run], mechanism, FitOptions(sensors="imu", hold="average", smoothing_velocity=smoothing))
        assert found.converged
        return np.abs((found.beta - true) / found.std)

    assert np.max(scores("auto")) < 3.5
    assert np.max(scores("given")) > 5.0
