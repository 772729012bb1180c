"""Prediction tables made by hand."""

from collections.abc import Mapping

import numpy as np

from estimator.prediction import PredictedRun


def predicted_run(name: str, rate_hz: float, measured: Mapping[str, np.ndarray],
                  errors: Mapping[float, np.ndarray | float]) -> PredictedRun:
    """One stretch whose channels are simulated with `errors` by horizon, (N,) or NaN where it diverges."""
    values = np.array(list(measured.values()))
    count = values.shape[1]
    horizons = tuple(errors)
    simulated = np.stack([values + error for error in errors.values()])[None]
    starts = np.stack([np.zeros(count) if np.isinf(h) else np.arange(count) // (h * rate_hz) * (h * rate_hz)
                       for h in horizons]).astype(np.intp)
    return PredictedRun(name, rate_hz, np.arange(count) / rate_hz, np.array([count]), tuple(measured), values,
                        values[None].copy(), horizons, simulated, starts,
                        np.array([[int(np.isnan(x).any()) for x in simulated[0]]]), np.zeros(1), np.ones((count, 1)),
                        np.zeros((1, count, 1)))
