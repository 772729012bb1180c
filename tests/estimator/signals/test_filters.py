"""The zero-phase filter against SciPy's."""

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, mark
from scipy.signal import butter, lfilter, sosfiltfilt

from estimator.signals import causal, encoder_level, lowpass


@mark.parametrize("order", range(1, 9))
@mark.parametrize("cutoff_hz", [1.0, 10.0, 45.0])
def test_it_is_scipys(order: int, cutoff_hz: float) -> None:
    rng = np.random.default_rng(order)
    x = np.cumsum(rng.normal(size=(700, 3)), axis=0)
    x[:, 1] = 0.0
    sos = butter(order, cutoff_hz, output="sos", fs=100.0)
    known = sosfiltfilt(sos, x, axis=0, padlen=int(3 * 100.0 / cutoff_hz))
    assert_allclose(lowpass(x, cutoff_hz, 100.0, order), known, rtol=0.0, atol=1e-9 * np.abs(x).max())


@mark.parametrize("numerator, denominator", [([1.0], [1.0, -0.9]), ([1.0, -0.5], [2.0, -1.9]),
                                                        ([3.0, -6.0, 3.0], [5.0, -9.0, 4.5])])
def test_the_causal_filter_is_scipys(numerator: list[float], denominator: list[float]) -> None:
    x = np.random.default_rng(0).normal(size=700)
    known = lfilter(numerator, denominator, x)
    found = causal(x, np.array(numerator), np.array(denominator))
    assert_allclose(found, known, rtol=0.0, atol=1e-12 * np.abs(known).max())


@mark.parametrize("fading", [0.0, 1e-25])
def test_an_encoder_is_as_exact_as_its_counts(fading: float) -> None:
    """Of a record that is at rest for half of its time; a file's zeros may be what a filter left of them."""
    count = 2.0 * np.pi / 8192
    angle = np.round(np.where(np.arange(2000) < 1000, 0.0, np.sin(0.003 * np.arange(2000))) / count) * count
    angle[:50] += fading * np.arange(50)
    assert encoder_level(angle) == approx(count / np.sqrt(12.0), rel=1e-6)
