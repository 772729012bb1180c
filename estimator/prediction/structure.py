"""`repeated_share`: how much of a residual is a function of the state that repeats from run to run.

What a model leaves is structure where it is a function of the state, and a disturbance where it is not. A ridge
regression on splines predicts each run from the others (leave-one-run-out cross-validation, Stone 1974).
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray

KNOTS, PAIR_KNOTS = 10, 5
"""Knots of the splines of one variable, and of each variable of a pair."""
WIDTHS = (0.05, 0.15, 0.4)
"""Widths of the stop operators, as shares of a joint's range of angles."""
MOST_SAMPLES = 20_000
"""Samples, evenly taken, by which structure is sought."""
RIDGES = np.logspace(-4.0, 2.0, 7)
"""Penalties that are compared, in units of a column's mean square times the number of samples."""


def taken(count: int) -> slice:
    """Samples by which structure is sought, of so many in all."""
    return slice(None, None, max(1, count // MOST_SAMPLES))


def state_columns(q: FloatArray, v: FloatArray, others: FloatArray, ends: NDArray[np.int64]) -> FloatArray:
    """(T, B) at the T samples `taken`: splines of angles q (N, n), rates v (N, n), `others` (N, V), and of each pair;
    splines of each angle by direction of its motion; stop operators of the angles.

    Stop operators (Visintin, Differential Models of Hysteresis, 1994) stand for hysteresis; they begin at rest in each
    segment up to `ends`.
    """
    which = taken(len(q))
    q, v, ends = q[which], v[which], -(-ends // (which.step or 1))
    stopped = [_stopped(q, width, ends) for width in np.ptp(q, axis=0) * np.array(WIDTHS)[:, None]]
    every = np.column_stack([q, v, others[which]]).T
    single = [_hats(x, KNOTS) for x in every]
    pairs = [np.einsum("ni,nj->nij", a, b).reshape(len(a), -1)
             for a, b in combinations([_hats(x, PAIR_KNOTS) for x in every], 2)]
    directed = [_hats(x, KNOTS) * np.sign(rate)[:, None] for x, rate in zip(q.T, v.T)]
    return np.concatenate([*single, *pairs, *directed, *stopped], axis=1)


def _hats(x: FloatArray, knots: int) -> FloatArray:
    """(N, knots) linear splines with knots at even quantiles of x (N,)."""
    at = np.unique(np.quantile(x, np.linspace(0.0, 1.0, knots)))
    return np.stack([np.interp(x, at, row) for row in np.eye(at.size)], axis=-1)


def _stopped(angles: FloatArray, width: FloatArray, ends: NDArray[np.int64]) -> FloatArray:
    """(N, n) the part of each angle's way since it last turned, at most `width` (n,)."""
    step = np.diff(angles, axis=0, prepend=angles[:1])
    step[ends[:-1]] = 0.0
    out, now = np.empty_like(angles), np.zeros_like(width)
    for k, move in enumerate(step):
        now = np.minimum(np.maximum(now + move, -width), width)
        out[k] = now
    return out


def predict_runs(residuals: FloatArray, columns: FloatArray, run: NDArray[np.intp]) -> FloatArray:
    """(N, J) the residuals of each run as predicted from the others, each with the ridge penalty best over all runs."""
    which = np.unique(run)
    columns = columns / np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    parts = [(columns[run == k], residuals[run == k]) for k in which]
    grams, rights = np.stack([a.T @ a for a, _ in parts]), np.stack([a.T @ y for a, y in parts])
    solved = [np.linalg.eigh(grams.sum(axis=0) - one) for one in grams]
    best, least = np.zeros_like(residuals), np.full(residuals.shape[1], np.inf)
    for ridge in RIDGES:
        out = np.empty_like(residuals)
        for k, (values, vectors) in enumerate(solved):
            own, count = run == which[k], len(residuals) - len(parts[k][1])
            onto = vectors.T @ (rights.sum(axis=0) - rights[k])
            out[own] = parts[k][0] @ (vectors @ (onto / (np.maximum(values, 0.0) + ridge * count)[:, None]))
        errors = np.sum((residuals - out) ** 2, axis=0)
        better = errors < least
        best[:, better], least[better] = out[:, better], errors[better]
    return best


def repeated_share(residuals: FloatArray, columns: FloatArray, run: NDArray[np.intp]) -> FloatArray:
    """(J,) share of the mean square of each of `residuals` (N, J) that `columns` (N, B) predict in runs that they were
    not fitted to; 0 where they predict none."""
    whole, out = np.sum(residuals**2, axis=0), np.zeros(residuals.shape[1])
    some = whole > 0.0
    if np.unique(run).size < 2 or not some.any():
        return out
    errors = residuals[:, some] - predict_runs(residuals[:, some], columns, run)
    out[some] = np.maximum(0.0, 1.0 - np.sum(errors**2, axis=0) / whole[some])
    return out
