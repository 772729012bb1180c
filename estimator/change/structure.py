"""`Structure`: unexplained structure of a session's runs, in the span of all columns: common, and of each run.

Score s_r = I_r (theta + u_r) + e_r, e_r of covariance I_r. theta is common to the runs of a session, u_r one run's own;
both are normal with mean zero and, in units of what one run tells of a column, of one variance for all columns:
`common` and `own`. Parameters have a flat prior in theta. What drifts from run to run, as a joint's friction does with
temperature, is a few columns: each of these has a further variance in u_r, its `drift`. With u_r integrated out a run
has the score (1 + I_r U)^-1 s_r and the information (1 + I_r U)^-1 I_r, where U is the covariance of u_r.

All variances maximise the restricted likelihood of the runs (Patterson and Thompson, Biometrika 58, 1971). Drifting
columns are selected forward, the one of the largest approximate gain first (as Tipping and Faul, AISTATS 2003), while
a likelihood ratio test of the variance is significant over all columns. With few runs the maximum is often at zero, as
if runs did not differ. A gamma prior of shape 2 on the standard deviations `common` and `own` keeps these above zero
(Chung et al., Psychometrika 78, 2013).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from daq import FloatArray
from estimator.score import ALPHA, Score

PRIOR_RUNS = 8
"""Degrees of freedom that the variance shared by all columns adds; the true variance differs from column to column."""
SMALLEST = 1e-9
"""Eigenvalues of a run's information below this share of the largest one are dropped."""
RUNS_A_DRIFT = 2
"""Runs that each drift needs: few do not determine many."""
RANGE = (-20.0, 20.0)
"""Of log variances"""
STOP = 3e-3
"""Slope of the log likelihood by a log variance at which a search ends: a standard deviation is that exact, as a share,
where the runs determine it at all"""
STEP = 3.0
"""Largest change of a log variance in one search"""
GRID = np.logspace(-3, 6, 37)
"""Variances that are tried for a column before it is selected"""


@dataclass(frozen=True)
class Structure:
    """Structure of the residuals of one session's runs, or of each of several."""

    common: float
    own: float
    unit: FloatArray
    """(m,) variance of each column's size by one run alone"""
    parameters: int
    freedom: float
    """Degrees of freedom of a size's variance: each session's runs less one, plus PRIOR_RUNS"""
    drift: FloatArray
    """(m,) further variance of one run's own structure, in units of `unit`; zero for most columns"""

    @property
    def precision(self) -> FloatArray:
        """(m,) of theta's prior; zero for parameters."""
        found = 1.0 / (self.common * self.unit)
        found[: self.parameters] = 0.0
        return found

    @cached_property
    def scatter(self) -> FloatArray:
        """(m,) variance of each column's size in one run's own structure."""
        return (self.own + self.drift) * self.unit

    def seen(self, run: Score) -> tuple[FloatArray, FloatArray]:
        """The run's score (m,) and information (m, m), its own structure integrated out."""
        spread = np.eye(self.unit.size) + run.information * self.scatter
        table = np.linalg.solve(spread, np.column_stack([run.score, run.information]))
        return np.asarray(table[:, 0]), 0.5 * np.asarray(table[:, 1:] + table[:, 1:].T)


class _Run(NamedTuple):
    """Of one run: y = A (theta + u) + e of unit covariance, A^T A its information."""

    y: FloatArray
    """(k,)"""
    columns: FloatArray
    """(k, m) A. Its rows are orthogonal."""
    power: FloatArray
    """(k,) squares of their lengths"""


class _Variances(NamedTuple):
    """Of common structure, of runs' own structure, and of the drifting columns `where`."""

    common: float
    own: float
    drift: FloatArray
    where: tuple[int, ...]


class _Slope(NamedTuple):
    """-log restricted likelihood of one session, and what its slope is made of."""

    misfit: float
    common: float
    """Slope by the variance `common`"""
    known: FloatArray
    """(runs, m) information of each column's size in each run's own structure, all else integrated out"""
    score: FloatArray
    """(runs, m) its score"""

    @property
    def columns(self) -> FloatArray:
        """(m,) slope by the variance of each column in runs' own structure."""
        return np.asarray(0.5 * (self.known - self.score**2).sum(axis=0))


def find_structure(sessions: Sequence[Sequence[Score]], parameters: int) -> Structure:
    """The likeliest structure of the runs within each of `sessions`, one of several having a theta of its own; the
    first `parameters` columns are the model's parameters."""
    from scipy.stats import chi2

    information = np.mean([np.diag(run.information) for runs in sessions for run in runs], axis=0)
    unit = 1.0 / np.maximum(information, 1e-300)
    rows = [_rows(runs, np.sqrt(unit)) for runs in sessions]
    # a variance at its bound of zero: half of its likelihood ratios are zero
    enough = 0.5 * float(chi2.isf(2.0 * ALPHA / unit.size, 1))
    misfit, found = _fit(rows, parameters, _Variances(1.0, 0.1, np.zeros(0), ()))
    while RUNS_A_DRIFT * (len(found.where) + 1) <= sum(map(len, rows)):
        k, variance, gain = _likeliest_drift([_restricted(runs, parameters, found) for runs in rows])
        if k in found.where or not gain > enough:
            break
        less, more = _fit(rows, parameters, found._replace(drift=np.append(found.drift, variance),
                                                           where=(*found.where, k)))
        if not misfit - less > enough:
            break
        misfit, found = less, more
    drift = np.zeros(unit.size)
    drift[list(found.where)] = found.drift
    freedom = PRIOR_RUNS + sum(len(runs) - 1.0 for runs in sessions)
    return Structure(found.common, found.own, unit, parameters, freedom, drift)


def _rows(runs: Sequence[Score], scale: FloatArray) -> list[_Run]:
    found = []
    for run in runs:
        values, vectors = np.linalg.eigh(run.information * np.outer(scale, scale))
        kept = values > SMALLEST * values[-1]
        root = np.sqrt(values[kept])
        found.append(_Run((vectors[:, kept] / root).T @ (run.score * scale), (vectors[:, kept] * root).T, values[kept]))
    return found


def _fit(sessions: Sequence[Sequence[_Run]], parameters: int, begin: _Variances) -> tuple[float, _Variances]:
    """The likeliest variances, and the -log likelihood with their prior; from `begin` on."""
    from scipy.optimize import minimize

    where = list(begin.where)

    def of(logs: FloatArray) -> _Variances:
        values = np.exp(logs)
        return _Variances(float(values[0]), float(values[1]), values[2:], begin.where)

    def misfit(logs: FloatArray) -> tuple[float, FloatArray]:
        at = of(logs)
        parts = [_restricted(runs, parameters, at) for runs in sessions]
        columns = np.sum([part.columns for part in parts], axis=0)
        slope = np.array([sum(part.common for part in parts), columns.sum(), *columns[where]]) * np.exp(logs)
        slope[:2] -= 0.5
        return sum(part.misfit for part in parts) - 0.5 * float(logs[:2].sum()), slope

    logs = np.clip(np.log([begin.common, begin.own, *begin.drift]), *RANGE)
    while True:  # not far at once: where all variances are immense, the likelihood has another maximum
        near = [(max(x - STEP, RANGE[0]), min(x + STEP, RANGE[1])) for x in map(float, logs)]
        found = minimize(misfit, logs, method="L-BFGS-B", jac=True, bounds=near, options={"ftol": 1e-9, "gtol": STOP})
        done = np.abs(found.x - logs).max() < 0.99 * STEP
        logs = found.x
        if done:
            return float(found.fun), of(logs)


def _likeliest_drift(slopes: Sequence[_Slope]) -> tuple[int, float, float]:
    """Column whose further variance raises the log likelihood most, this variance, and by how much; runs as if
    independent. What all runs of a session have alike is no drift: a column gains no more than with a free mean."""
    gain = np.zeros((slopes[0].known.shape[1], GRID.size))
    for one in slopes:
        known, score = one.known[:, :, None], one.score[:, :, None]
        weight = known / (1.0 + GRID * known)
        gain += 0.5 * (score**2 * GRID / (1.0 + GRID * known) - np.log1p(GRID * known)).sum(axis=0)
        mean, before = ((score / (1.0 + v * known)).sum(axis=0) for v in (GRID, 0.0))
        told, first = (np.maximum(x.sum(axis=0), 1e-300) for x in (weight, known))
        gain += np.minimum(0.5 * (mean**2 / told - before**2 / first - np.log(told / first)), 0.0)
    k, at = np.unravel_index(int(np.argmax(gain)), gain.shape)
    return int(k), float(GRID[at]), float(gain[k, at])


def _restricted(runs: Sequence[_Run], parameters: int, at: _Variances) -> _Slope:
    """-log restricted likelihood of one session.

    V is the covariance of y by noise and runs' own structure. W V W^T = 1. One QR factor of
    [[W (sqrt(common) C, X, y)], [1, 0, 0]] has the log determinants in its diagonal, and in its last row and column
    what is left of y. With Q its upper rows without the last column, P = W^T (1 - Q Q^T) W.
    """
    where, m = list(at.where), runs[0].columns.shape[1]
    blocks, determinant = [], 0.0
    for run in runs:
        own = 1.0 + at.own * run.power
        table = np.column_stack([run.columns, run.y]) / np.sqrt(own)[:, None]
        vectors, lengths, _ = np.linalg.svd(table[:, where] * np.sqrt(at.drift), full_matrices=False)
        table -= (vectors * (1.0 - 1.0 / np.sqrt(1.0 + lengths**2))) @ (vectors.T @ table)
        determinant += 0.5 * float(np.log(own).sum() + np.log1p(lengths**2).sum())
        blocks.append(table)
    every = np.concatenate(blocks)
    shared = np.sqrt(at.common) * every[:, parameters:m]
    stacked = np.vstack([np.column_stack([shared, every[:, :parameters], every[:, m]]), np.eye(m - parameters, m + 1)])
    q, r = np.linalg.qr(stacked)
    upper = q[: len(every), :-1]
    left = q[: len(every), -1] * r[-1, -1]
    pivots = np.abs(np.diag(r)[:-1])
    misfit = determinant + float(np.log(np.maximum(pivots, 1e-300)).sum()) + 0.5 * float(r[-1, -1] ** 2)
    common = 0.5 * float((shared**2).sum() - ((upper.T @ shared) ** 2).sum() - ((left @ shared) ** 2).sum()) / at.common
    edges = np.cumsum([0, *(len(block) for block in blocks)])
    known, score = [], []
    for block, begin, end in zip(blocks, edges, edges[1:]):
        a = block[:, :m]
        known.append((a**2).sum(axis=0) - ((upper[begin:end].T @ a) ** 2).sum(axis=0))
        score.append(left[begin:end] @ a)
    return _Slope(misfit, common, np.array(known), np.array(score))
