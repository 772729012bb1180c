"""`Contrast`: what one session's runs hold that another's do not, as a score and an information over all columns.

Of run r, its own structure integrated out (`structure`), score s_r = I_r theta_r + noise of covariance I_r, where
theta_r is common to the runs of a session and L is the precision of its prior.

`contrast`: test runs have theta + delta, reference runs theta. With theta integrated out, delta has the score
q = s_T - I_T (I_T + I_R + L)^-1 (s_T + s_R) and the information Q = I_T - I_T (I_T + I_R + L)^-1 I_T.

`difference`: neither session is the reference. A has theta - delta/2, B has theta + delta/2. Exchanging A and B turns
the sign of delta and nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq import FloatArray
from estimator.change.scores import RunScore
from estimator.change.structure import Structure

HIDDEN = 1e-6
"""Share of a column's information below which nothing is left of it."""
SINGULAR = 1e-9
"""Square of a pivot of Cholesky's factor below which a matrix of unit diagonal is inverted by its eigenvalues."""


@dataclass(frozen=True)
class Contrast:
    """Score and information of a change, structure that is no change integrated out."""

    score: FloatArray
    """(m,)"""
    information: FloatArray
    """(m, m)"""

    def along(self, basis: FloatArray) -> Contrast:
        """Contrast of the k sizes that move all columns by `basis` (m, k) each."""
        return Contrast(basis.T @ self.score, basis.T @ self.information @ basis)

    def gain(self) -> float:
        """Fall of -2 log likelihood by a change of all columns."""
        return float(self.size() @ self.score)

    def size(self) -> FloatArray:
        """(m,) generalised least squares."""
        return np.asarray(self.covariance() @ self.score)

    @property
    def scale(self) -> FloatArray:
        """(m,) root of each column's own information."""
        return np.sqrt(np.maximum(np.diag(self.information), 1e-300))

    @property
    def correlation(self) -> FloatArray:
        """(m, m) information of columns in units of their own."""
        return np.asarray(self.information / np.outer(self.scale, self.scale))

    def covariance(self) -> FloatArray:
        """(m, m) of the sizes."""
        scale = self.scale
        square = np.outer(scale, scale)
        return np.asarray(np.linalg.pinv(self.information / square, HIDDEN, hermitian=True) / square)


def seen(runs: Sequence[RunScore], structure: Structure) -> list[Contrast]:
    """Score and information of each run, its own structure integrated out."""
    return [Contrast(*structure.seen(run)) for run in runs]


def total(parts: Sequence[Contrast]) -> Contrast:
    """The sum of their scores and informations."""
    return Contrast(np.sum([p.score for p in parts], axis=0), np.sum([p.information for p in parts], axis=0))


def contrast(test: Contrast, reference: Contrast, structure: Structure) -> Contrast:
    """Contrast of test runs with reference runs, given their totals and the `structure` of the reference."""
    return _without_common(test, test.information, total([test, reference]), structure)


def difference(a: Contrast, b: Contrast, structure: Structure) -> Contrast:
    """Contrast of session B with session A, given their totals and the `structure` of both."""
    half = Contrast(0.5 * (b.score - a.score), 0.25 * (a.information + b.information))
    return _without_common(half, 0.5 * (b.information - a.information), total([a, b]), structure)


def _without_common(own: Contrast, mixed: FloatArray, common: Contrast, structure: Structure) -> Contrast:
    """`own` with the common theta integrated out; `mixed` (m, m) is the information between the two."""
    whole = common.information + np.diag(structure.precision)
    carry = mixed @ _inverse(whole)
    information = own.information - carry @ mixed.T
    return Contrast(own.score - carry @ common.score, 0.5 * (information + information.T))


def _inverse(whole: FloatArray) -> FloatArray:
    """(m, m) inverse of a covariance's like; of a singular one that of its regular part."""
    from scipy.linalg.lapack import dpotrf, dpotri

    scale = 1.0 / np.sqrt(np.maximum(np.diag(whole), 1e-300))
    square = np.outer(scale, scale)
    factor, failed = dpotrf(whole * square, lower=1, clean=1)
    if failed or np.diag(factor).min() ** 2 < SINGULAR:
        return np.asarray(np.linalg.pinv(whole * square, 1e-12, hermitian=True) * square)
    half = np.tril(dpotri(factor, lower=1)[0])
    return np.asarray((half + np.tril(half, -1).T) * square)
