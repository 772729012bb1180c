"""`Structure`: unexplained structure of a session's runs, in the span of all columns: common, and of each run.

Score s_r = I_r (theta + u_r) + e_r, e_r of covariance I_r. theta is common to the runs of a session, u_r one run's own;
both are normal with mean zero and, in units of what one run tells of a column, of one variance for all columns:
`common` and `own`. Parameters have a flat prior in theta. With u_r integrated out a run has the score
(1 + I_r U)^-1 s_r and the information (1 + I_r U)^-1 I_r, where U is the covariance of u_r.

Both variances maximise the restricted likelihood of the runs (Patterson and Thompson, Biometrika 58, 1971).
With few runs the maximum is often at zero, as if runs did not differ. A gamma prior of shape 2 on each standard
deviation keeps it above zero (Chung et al., Psychometrika 78, 2013).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from daq import FloatArray
from estimator.change.scores import RunScore

PRIOR_RUNS = 8
"""Degrees of freedom that the variance shared by all columns adds; the true variance differs from column to column."""
SMALLEST = 1e-9
"""Eigenvalues of a run's information below this share of the largest one are dropped."""


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

    @property
    def precision(self) -> FloatArray:
        """(m,) of theta's prior; zero for parameters."""
        found = 1.0 / (self.common * self.unit)
        found[: self.parameters] = 0.0
        return found

    def seen(self, run: RunScore) -> tuple[FloatArray, FloatArray]:
        """The run's score (m,) and information (m, m), its own structure integrated out."""
        spread = np.eye(self.unit.size) + run.information * (self.own * self.unit)
        information = np.linalg.solve(spread, run.information)
        return np.asarray(np.linalg.solve(spread, run.score)), 0.5 * np.asarray(information + information.T)


class _Rows(NamedTuple):
    """Of all runs of a session: y = A_r theta + A_r u_r + e of unit covariance, A_r^T A_r = I_r."""

    y: FloatArray
    """(k,)"""
    free: FloatArray
    """(k, parameters)"""
    common: FloatArray
    """(k, m) root of the covariance by a common structure of variance one"""
    own: FloatArray
    """(k,) variances by runs' own structures of variance one: a run's rows are orthogonal, by its eigenvectors"""


def find_structure(sessions: Sequence[Sequence[RunScore]], parameters: int) -> Structure:
    """The likeliest structure of the runs within each of `sessions`, one of several having a theta of its own; the
    first `parameters` columns are the model's parameters."""
    from scipy.optimize import minimize

    information = np.mean([np.diag(run.information) for runs in sessions for run in runs], axis=0)
    unit = 1.0 / np.maximum(information, 1e-300)
    rows = [_rows(runs, np.sqrt(unit), parameters) for runs in sessions]
    begin = np.log([1.0, 0.1])
    found = minimize(_misfit, begin, (rows,), "Nelder-Mead", options={
        "initial_simplex": begin + 2.0 * np.array([[0, 0], [1, 0], [0, 1]]), "xatol": 0.05, "fatol": 0.05})
    common, own = np.exp(found.x)
    freedom = PRIOR_RUNS + sum(len(runs) - 1.0 for runs in sessions)
    return Structure(float(common), float(own), unit, parameters, freedom)


def _rows(runs: Sequence[RunScore], scale: FloatArray, parameters: int) -> _Rows:
    parts, y, own = [], [], []
    for run in runs:
        values, vectors = np.linalg.eigh(run.information * np.outer(scale, scale))
        kept = values > SMALLEST * values[-1]
        root = np.sqrt(values[kept])
        parts.append((vectors[:, kept] * root).T)
        y.append((vectors[:, kept] / root).T @ (run.score * scale))
        own.append(values[kept])
    every = np.concatenate(parts)
    return _Rows(np.concatenate(y), every[:, :parameters], every[:, parameters:], np.concatenate(own))


def _misfit(logs: FloatArray, sessions: Sequence[_Rows]) -> float:
    """-log restricted likelihood of (common, own), and their prior; inf where a variance is too large for a number."""
    with np.errstate(over="ignore"):
        common, own = np.exp(logs)
    found = sum(_restricted(rows, common, own) for rows in sessions) - 0.5 * np.sum(logs)
    return float(found) if np.isfinite(found) else np.inf


def _restricted(rows: _Rows, common: float, own: float) -> float:
    """-log restricted likelihood of one session.

    With V = D + common C C^T, one QR factor of [[D^-1/2 (sqrt(common) C, X, y)], [I, 0, 0]] has log det V - log det D
    and log det X^T V^-1 X in its diagonal, and in its last row what is left of y.
    """
    with np.errstate(all="ignore"):
        deviation = np.sqrt(1.0 + own * rows.own)
        table = np.column_stack([np.sqrt(common) * rows.common, rows.free, rows.y]) / deviation[:, None]
        if not np.isfinite(table).all():
            return np.inf
        r = np.asarray(np.linalg.qr(np.vstack([table, np.eye(rows.common.shape[1], table.shape[1])]), mode="r"))
        pivots = np.abs(np.diag(r)[: table.shape[1] - 1])
        left = r[table.shape[1] - 1 :, -1]
        return float(np.log(deviation).sum() + np.log(np.maximum(pivots, 1e-300)).sum() + 0.5 * left @ left)
