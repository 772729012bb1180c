"""Allan deviation against closed forms: white noise falls with the root of time, a random walk rises with it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from daq.calibration.allan import FLICKER, allan_curve


def test_white_noise_has_its_density_and_falls_with_the_root_of_time() -> None:
    rate, density = 200.0, np.array([0.01, 0.002])
    noise = np.random.default_rng(1).standard_normal((200_000, 2)) * density * np.sqrt(rate)
    curve = allan_curve(noise + np.array([5.0, -3.0]), rate)
    assert_allclose(curve.noise_density, density, rtol=0.02)
    assert_allclose(curve.sigma[0], noise.std(axis=0), rtol=0.01)  # at one sample: its own deviation
    early = curve.tau_s < 20.0
    expected = density / np.sqrt(curve.tau_s[early, None])
    assert_allclose(curve.sigma[early], expected, rtol=0.15)


def test_a_random_walk_rises_with_the_root_of_a_third_of_the_time() -> None:
    rate, k = 100.0, 0.05  # K: sigma = K sqrt(tau / 3)
    walk = np.cumsum(np.random.default_rng(2).standard_normal((200_000, 1)) * k / np.sqrt(rate), axis=0)
    curve = allan_curve(walk, rate)
    middle = (curve.tau_s > 1.0) & (curve.tau_s < 20.0)
    assert_allclose(curve.sigma[middle, 0], k * np.sqrt(curve.tau_s[middle] / 3), rtol=0.15)


def test_a_line_drifts_by_its_slope() -> None:
    # a ramp of r per second: sigma = r tau / sqrt(2), exactly
    curve = allan_curve(0.3 * np.arange(1000.0)[:, None] / 50.0, 50.0)
    assert_allclose(curve.sigma[:, 0], 0.3 * curve.tau_s / np.sqrt(2), rtol=1e-6)
    assert curve.bias_instability[0] == pytest.approx(curve.sigma[:, 0].min() / 0.664)
    assert abs(FLICKER - np.sqrt(2 * np.log(2) / np.pi)) < 1e-3


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(ValueError, match="too few"):
        allan_curve(np.zeros((49, 1)), 100.0)
