"""`Contrast`: what test runs hold that reference runs do not, as a score and an information over all columns.

Of run r, score s_r = I_r (theta + delta [r is a test run]) + noise of covariance I_r. theta is the structure that the
reference has in the span of all columns, with a name or without: a ridge prior holds it near zero, parameters are
free. With theta integrated out, delta has the score q = s_T - I_T (I_T + I_R + L)^-1 (s_T + s_R) and the information
Q = I_T - I_T (I_T + I_R + L)^-1 I_T, where L is the prior's precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.change.scores import RunScore

RIDGE = 0.01
"""Precision of the structure's prior in units of a column's information in a reference run."""
PRIOR_RUNS = 8
"""Runs that the median scatter of all candidates counts for, in addition to a candidate's own."""
HIDDEN = 1e-6
"""Share of a column's information below which nothing is left of it."""
Columns = NDArray[np.intp]


@dataclass(frozen=True)
class Contrast:
    """Score and information of a change, the reference's structure integrated out."""

    score: FloatArray
    """(m,)"""
    information: FloatArray
    """(m, m)"""

    def gain(self, columns: Columns) -> float:
        """Fall of -2 log likelihood by a change of these columns, white noise taken for granted."""
        return float(self.size(columns) @ self.score[columns])

    def size(self, columns: Columns) -> FloatArray:
        """(k,) generalised least squares."""
        return np.asarray(self.covariance(columns) @ self.score[columns])

    def covariance(self, columns: Columns) -> FloatArray:
        """(k, k) of the sizes, white noise taken for granted."""
        own = self.information[np.ix_(columns, columns)]
        scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
        return np.asarray(np.linalg.pinv(own / np.outer(scale, scale), HIDDEN, hermitian=True)
                          / np.outer(scale, scale))


def contrast(test: Sequence[RunScore], reference: Sequence[RunScore], parameters: int) -> Contrast:
    """Of the `test` runs against the `reference` runs; the first `parameters` columns have no prior."""
    s_test, i_test = _sum(test)
    s_ref, i_ref = _sum(reference)
    prior = RIDGE * np.diag(i_ref) / len(reference)
    prior[:parameters] = 0.0
    whole = i_test + i_ref + np.diag(prior)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(whole), 1e-300))
    inverse = np.linalg.pinv(whole * np.outer(scale, scale), 1e-12, hermitian=True) * np.outer(scale, scale)
    carry = i_test @ inverse
    information = i_test - carry @ i_test
    return Contrast(s_test - carry @ (s_test + s_ref), 0.5 * (information + information.T))


def scatter(groups: Sequence[Columns], runs: Sequence[RunScore], parameters: int) -> FloatArray:
    """(g,) variance of each group's change between runs of one session over white noise's, shrunk to the median.

    Each run is contrasted with the others (leave-one-out).
    """
    ratios = np.empty((len(runs), len(groups)))
    for k, run in enumerate(runs):
        one = contrast([run], [r for j, r in enumerate(runs) if j != k], parameters)
        ratios[k] = [one.gain(columns) / len(columns) for columns in groups]
    own = ratios.mean(axis=0)
    common = max(1.0, float(np.median(own)))
    return np.maximum(1.0, (PRIOR_RUNS * common + len(runs) * own) / (PRIOR_RUNS + len(runs)))


def freedom(runs: int) -> float:
    """Degrees of freedom of `scatter`."""
    return float(PRIOR_RUNS + runs - 1)


def _sum(runs: Sequence[RunScore]) -> tuple[FloatArray, FloatArray]:
    return (np.sum([r.score for r in runs], axis=0), np.sum([r.information for r in runs], axis=0))
