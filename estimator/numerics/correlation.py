"""`correlate`: normalised correlation of two signals that lie in segments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import FloatArray


def correlate(first: Sequence[FloatArray], second: Sequence[FloatArray], lags: FloatArray) -> FloatArray:
    """(k,) normalised correlation of `first` (t + lag) with `second` (t), summed over segments; NaN takes no part."""
    total, scale = np.zeros(lags.size), [0.0, 0.0]
    means = [_mean(np.concatenate(list(x))) for x in (first, second)]
    for a, b in zip(first, second):
        x, y = np.nan_to_num(a - means[0]), np.nan_to_num(b - means[1])
        scale = [scale[0] + float(x @ x), scale[1] + float(y @ y)]
        for k, lag in enumerate(lags.astype(int)):
            if abs(lag) < x.size:
                total[k] += float(x[lag:] @ y[: y.size - lag] if lag >= 0 else x[:lag] @ y[-lag:])
    return np.asarray(total / max(np.sqrt(scale[0] * scale[1]), 1e-300))


def _mean(x: FloatArray) -> float:
    """Mean of what is not NaN; zero where all is, as in a fit whose motion is lost."""
    values = x[~np.isnan(x)]
    return float(values.mean()) if values.size else 0.0
