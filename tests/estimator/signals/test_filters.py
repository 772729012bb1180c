"""The zero-phase filter against SciPy's."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from estimator.signals import lowpass


@pytest.mark.parametrize("order", range(1, 9))
@pytest.mark.parametrize("cutoff_hz", [1.0, 10.0, 45.0])
def test_it_is_scipys(order: int, cutoff_hz: float) -> None:
    rng = np.random.default_rng(order)
    x = np.cumsum(rng.normal(size=(700, 3)), axis=0)
    x[:, 1] = 0.0
    sos = butter(order, cutoff_hz, output="sos", fs=100.0)
    known = sosfiltfilt(sos, x, axis=0, padlen=int(3 * 100.0 / cutoff_hz))
    np.testing.assert_allclose(lowpass(x, cutoff_hz, 100.0, order), known, rtol=0.0, atol=1e-9 * np.abs(x).max())
