"""How far a model predicts: free runs over pieces of a horizon, each begun in the measured state.

One free run over a whole record ends far off for any model of a chaotic leg, and says little of the next second. Over
pieces the error is that of a planner or a controller that looks so far ahead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from daq import Dataset, FloatArray
from estimator.fitting.smoothing import estimate_motion, reference_angles
from estimator.model import Mechanism, simulate
from estimator.options import FitOptions
from estimator.signals import differentiate, split_signals

HORIZONS_S = (0.1, 0.5, 1.0, 5.0)
LEAST_SAMPLES = 3
"""A piece of fewer samples predicts nothing."""
BLOWN = 3.0
"""A simulation that leaves the record's range by more than so many times its width has blown up."""


class Measured(NamedTuple):
    """One stretch of a record to predict: states to begin in, and what was read."""

    run: str
    rate_hz: float
    q: FloatArray
    """(N, n) [rad]"""
    qd: FloatArray
    reference: FloatArray
    """(N, n) as the encoders read, else as q."""
    tau: FloatArray
    """(N, n) [N m]"""


@dataclass(frozen=True)
class Predicted:
    """Errors of all pieces of one horizon."""

    horizon_s: float
    rmse: FloatArray
    """(n,) of the model, over the pieces that did not blow up [rad]."""
    baseline: FloatArray
    """(n,) of the last velocity kept, over the same."""
    pieces: int
    blown: int
    """Pieces whose simulation left all bounds; they are not in `rmse`."""


@dataclass(frozen=True)
class Horizons:
    """Errors of a model over pieces of a record, beside what costs nothing and what no model can undercut."""

    columns: tuple[str, ...]
    """Angle of each joint."""
    model: tuple[Predicted, ...]
    """By horizon, the whole stretches last."""
    against: tuple[Predicted, ...]
    """The same of another model; empty without one."""
    noise: FloatArray
    """(n,) rms of the readings about the model's own smoothed motion [rad]: what is left where nothing is foretold."""


def measured_states(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> list[Measured]:
    """States by filtered differences: of no model, so that models can be compared. Raises `FitError`."""
    found = []
    for s in split_signals(datasets, mechanism, options):
        k = differentiate(s, mechanism, min(10.0, 0.2 * s.rate_hz), options.filter_order, fused=True)
        found.append(Measured(s.run, s.rate_hz, k.q, k.qd, np.where(np.isfinite(s.angles), s.angles, k.q), s.torque))
    return found


def smoothed_states(datasets: Sequence[Dataset], mechanism: Mechanism, beta: FloatArray, options: FitOptions
                    ) -> list[Measured]:
    """States by the model's own smoother, as `validate` begins. Raises `FitError`."""
    found = []
    for data in datasets:
        for motion in estimate_motion([data], mechanism, beta, options):
            found.append(Measured(motion.run, data.rate_hz, motion.q, motion.qd,
                                  reference_angles(data, mechanism, motion), motion.tau_measured))
    return found


def predict(stretches: Sequence[Measured], mechanism: Mechanism, beta: FloatArray, hold: str,
            horizon_s: float | None) -> Predicted:
    """Free runs over consecutive pieces of `horizon_s`; None: of whole stretches.

    A piece counts to the last of its samples; stretches shorter than the horizon are left out.
    """
    squares, plain = np.zeros(mechanism.n), np.zeros(mechanism.n)
    count = samples = blown = 0
    longest = 0.0
    for s in stretches:
        length = len(s.q) - 1 if horizon_s is None else round(horizon_s * s.rate_hz)
        width = np.ptp(s.reference, axis=0).max(initial=0.0)
        if length < LEAST_SAMPLES:
            continue
        longest = max(longest, length / s.rate_hz)
        for start in range(0, len(s.q) - length, length):
            part = slice(start, start + length + 1)
            count += 1
            q, _, _ = simulate(mechanism, beta, s.q[start], s.qd[start], s.tau[part], 1.0 / s.rate_hz, hold,
                               guess=(s.q[part], s.qd[part]))
            error = q - s.reference[part]
            if not np.isfinite(error).all() or np.abs(error).max() > BLOWN * width:
                blown += 1
                continue
            kept = s.q[start] + s.qd[start] * (np.arange(length + 1) / s.rate_hz)[:, None]
            squares += np.sum(error**2, axis=0)
            plain += np.sum((kept - s.reference[part]) ** 2, axis=0)
            samples += length + 1
    nothing = np.full(mechanism.n, np.nan)
    return Predicted(longest if horizon_s is None else horizon_s,
                     np.sqrt(squares / samples) if samples else nothing,
                     np.sqrt(plain / samples) if samples else nothing, count, blown)


def prediction_score(stretches: Sequence[Measured], mechanism: Mechanism, beta: FloatArray, hold: str,
                     horizon_s: float = 1.0) -> float:
    """One number to choose by: the log of error over baseline, its mean over the joints; infinite where pieces blow
    up."""
    found = predict(stretches, mechanism, beta, hold, horizon_s)
    if found.blown or not found.pieces:
        return float("inf")
    return float(np.mean(np.log(np.maximum(found.rmse, 1e-12) / np.maximum(found.baseline, 1e-12))))
