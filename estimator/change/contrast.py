"""`Contrast`: what test runs hold that reference runs do not, as a score and an information over all columns.

Of run r, its own structure integrated out (`structure`), score s_r = I_r (theta + delta [r is a test run]) + noise of
covariance I_r. With theta integrated out, delta has the score q = s_T - I_T (I_T + I_R + L)^-1 (s_T + s_R) and the
information Q = I_T - I_T (I_T + I_R + L)^-1 I_T, where L is the precision of theta's prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.change.scores import RunScore
from estimator.change.structure import Structure

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
        """Fall of -2 log likelihood by a change of these columns."""
        return float(self.size(columns) @ self.score[columns])

    def size(self, columns: Columns) -> FloatArray:
        """(k,) generalised least squares."""
        return np.asarray(self.covariance(columns) @ self.score[columns])

    def covariance(self, columns: Columns) -> FloatArray:
        """(k, k) of the sizes."""
        own = self.information[np.ix_(columns, columns)]
        scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
        return np.asarray(np.linalg.pinv(own / np.outer(scale, scale), HIDDEN, hermitian=True)
                          / np.outer(scale, scale))


def contrast(test: Sequence[RunScore], reference: Sequence[RunScore], structure: Structure) -> Contrast:
    """Contrast of the `test` runs with the `reference` runs, given the `structure` of the reference."""
    s_test, i_test = _sum([structure.seen(run) for run in test])
    s_ref, i_ref = _sum([structure.seen(run) for run in reference])
    whole = i_test + i_ref + np.diag(structure.precision)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(whole), 1e-300))
    inverse = np.linalg.pinv(whole * np.outer(scale, scale), 1e-12, hermitian=True) * np.outer(scale, scale)
    carry = i_test @ inverse
    information = i_test - carry @ i_test
    return Contrast(s_test - carry @ (s_test + s_ref), 0.5 * (information + information.T))


def _sum(runs: Sequence[RunScore]) -> tuple[FloatArray, FloatArray]:
    return (np.sum([r.score for r in runs], axis=0), np.sum([r.information for r in runs], axis=0))
