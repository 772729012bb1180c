"""Filters against SciPy's."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfiltfilt

from estimator.signals import filter_causally, lowpass


@pytest.mark.parametrize("order", range(1, 9))
@pytest.mark.parametrize("cutoff_hz", [1.0, 10.0, 45.0])
def test_it_is_scipys(order: int, cutoff_hz: float) -> None:
    rng = np.random.default_rng(order)
    x = np.cumsum(rng.normal(size=(700, 3)), axis=0)
    x[:, 1] = 0.0
    sos = butter(order, cutoff_hz, output="sos", fs=100.0)
    known = sosfiltfilt(sos, x, axis=0, padlen=int(3 * 100.0 / cutoff_hz))
    np.testing.assert_allclose(lowpass(x, cutoff_hz, 100.0, order), known, rtol=0.0, atol=1e-9 * np.abs(x).max())


@pytest.mark.parametrize("numerator, denominator", [
    ([1.0], [1.0, -0.98]), ([1.0, -0.7], [2.0, -0.4]), ([1.0, -2.0, 1.0], [4.0, -7.2, 3.6])])
def test_a_causal_filter_starts_from_rest(numerator: list[float], denominator: list[float]) -> None:
    x = 3.0 + np.cumsum(np.random.default_rng(0).normal(size=400))
    known = lfilter(numerator, denominator, x)
    np.testing.assert_allclose(filter_causally(x, numerator, denominator), known, rtol=0.0,
                               atol=1e-12 * np.abs(known).max())
