"""`repeated_share`: how much of a residual is a function of the state that repeats from run to run.

What a model leaves is structure where it is a function of the state, and a disturbance where it is not. A ridge
regression on splines predicts each run from the others (leave-one-run-out cross-validation, Stone 1974).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray, IndexArray
from estimator.numerics import compile_kernel
from estimator.signals import slow_part

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
    every = np.column_stack([q, v, others[which]]).T
    single, coarse = [_hats(x, KNOTS) for x in every], [_hats(x, PAIR_KNOTS) for x in every]
    pairs = [(a[:, :, None] * b[:, None]).reshape(len(a), -1) for a, b in combinations(coarse, 2)]
    directed = [hats * np.sign(rate)[:, None] for hats, rate in zip(single, v.T)]
    return np.concatenate([*single, *pairs, *directed, _stopped(q, ends)], axis=1)


def driven_columns(torque: FloatArray, ends: NDArray[np.int64]) -> FloatArray:
    """(N, 2 V) torques (N, V), and how fast each of them changes a sample, within segments up to `ends`.

    A torque that acts later than it was measured, or that is held otherwise, leaves its rate; every other listed effect
    is a function of the state. The rate is that of the `slow_part`: the rest is noise.
    """
    parts = np.split(torque, ends[:-1])
    rates = [np.gradient(slow_part(part, 1.0), axis=0) if len(part) > 1 else np.zeros_like(part)
             for part in parts]
    return np.concatenate([torque, np.concatenate(rates)], axis=1)


def _hats(x: FloatArray, knots: int) -> FloatArray:
    """(N, knots) linear splines with knots at even quantiles of x (N,)."""
    at = np.unique(np.quantile(x, np.linspace(0.0, 1.0, knots)))
    out, row = np.zeros((x.size, at.size)), np.arange(x.size)
    if at.size == 1:
        return out + 1.0
    cell = np.clip(np.searchsorted(at, x, side="right") - 1, 0, at.size - 2)
    share = (x - at[cell]) / (at[cell + 1] - at[cell])
    out[row, cell], out[row, cell + 1] = 1.0 - share, share
    return out


def _stopped(angles: FloatArray, ends: NDArray[np.int64]) -> FloatArray:
    """(N, 3 n) the part of each angle's way since it last turned, at most each of `WIDTHS`."""
    step = np.diff(angles, axis=0, prepend=angles[:1])
    step[ends[:-1]] = 0.0
    out = np.tile(step, len(WIDTHS))
    _stop()(out, np.outer(WIDTHS, np.ptp(angles, axis=0)).ravel())
    return out


@cache
def _stop() -> Callable[..., None]:
    """The kernel that makes of steps (N, c), in place, their sum within -width and width (c,)."""

    def run(steps: Any, width: Any) -> None:
        for c in range(width.size):
            now = 0.0
            for k in range(steps.shape[0]):
                now = min(max(now + steps[k, c], -width[c]), width[c])
                steps[k, c] = now

    return compile_kernel(run, "f2 f1", exact=True)


def predict_runs(residuals: FloatArray, columns: FloatArray, run: IndexArray) -> FloatArray:
    """(N, J) the residuals of each run as predicted from the others, each with the ridge penalty best over all runs."""
    which = np.unique(run)
    count, joints = residuals.shape
    scale = 1.0 / np.maximum(np.sqrt(np.einsum("nb,nb->b", columns, columns) / count), 1e-12)
    parts = [(columns[run == k], residuals[run == k]) for k in which]
    grams = np.stack([a.T @ a for a, _ in parts]) * np.outer(scale, scale)
    rights = np.stack([scale[:, None] * (a.T @ y) for a, y in parts])
    out = np.empty((count, RIDGES.size, joints))
    for k, (a, y) in enumerate(parts):
        values, vectors = np.linalg.eigh(grams.sum(axis=0) - grams[k])
        onto = vectors.T @ (rights.sum(axis=0) - rights[k])
        shrunk = onto[:, None] / (np.maximum(values, 0.0)[:, None] + RIDGES * (count - len(y)))[:, :, None]
        out[run == which[k]] = (a @ (scale[:, None] * (vectors @ shrunk.reshape(len(values), -1)))).reshape(
            len(a), RIDGES.size, joints)
    best = np.argmin(np.sum((residuals[:, None] - out) ** 2, axis=0), axis=0)
    return out[:, best, np.arange(joints)]


def repeated_share(residuals: FloatArray, columns: FloatArray, run: IndexArray) -> FloatArray:
    """(J,) share of the mean square of each of `residuals` (N, J) that `columns` (N, B) predict in runs that they were
    not fitted to; 0 where they predict none."""
    whole, out = np.sum(residuals**2, axis=0), np.zeros(residuals.shape[1])
    some = whole > 0.0
    if np.unique(run).size < 2 or not some.any():
        return out
    errors = residuals[:, some] - predict_runs(residuals[:, some], columns, run)
    out[some] = np.maximum(0.0, 1.0 - np.sum(errors**2, axis=0) / whole[some])
    return out
