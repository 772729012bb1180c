"""`Contrast`: what one session's runs hold that another's do not, as a score and an information over all columns.

Of run r, its own structure integrated out (`structure`), score s_r = I_r theta_r + noise of covariance I_r, where
theta_r is common to the runs of a session: theta. L is the precision of its prior.

`contrast`: test runs have theta + delta, reference runs theta. `difference`: neither session is the reference. A has
theta - delta/2, B has theta + delta/2. Exchanging A and B turns the sign of delta and nothing else.

theta = u + alpha, u of the prior N(0, L^-1). Which change is likeliest is judged with alpha zero, so that all changes
are compared with one model of no change. The size of a change is a difference of levels: alpha is then flat, along
the same columns as delta. The prior alone would draw a level that all runs have, such as a delay, towards zero, and
its rest would count as change. With u integrated out, W = I_T + I_R + L, s = s_T + s_R, delta and alpha have

    score         q = s_T - I_T W^-1 s      and  L W^-1 s,
    information   Q = I_T - I_T W^-1 I_T,  I_T W^-1 L  and  L - L W^-1 L.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq import FloatArray
from estimator.change.structure import Structure
from estimator.score import Score, total

SINGULAR = 1e-9
"""Square of a pivot of Cholesky's factor below which a matrix of unit diagonal is inverted by its eigenvalues."""


@dataclass(frozen=True)
class Contrast:
    """Scores of a change delta and of the level alpha that both sessions have."""

    change: Score
    level: Score
    mixed: FloatArray
    """(m, m) information between change and level"""

    def along(self, basis: FloatArray) -> Score:
        """Score of the k sizes of a change that moves all columns by `basis` (m, k) each; alpha is zero."""
        return self.change.along(basis)

    def without(self, basis: FloatArray) -> Contrast:
        """The contrast with the change along `basis` (m, k) fitted and projected out, alpha zero."""
        return replace(self, change=self.change.without(basis))

    def measured(self, basis: FloatArray, others: FloatArray) -> Score:
        """Score of the k sizes along `basis`, `others` (m, l) fitted and projected out; alpha is free along both."""
        every, k = np.hstack([basis, others]), basis.shape[1]
        change, level = self.change.along(every), self.level.along(every)
        mixed = every.T @ self.mixed @ every
        pair = Score(np.concatenate([change.score, level.score]),
                     np.block([[change.information, mixed], [mixed.T, level.information]]))
        found = pair.without(np.eye(pair.score.size)[:, k:])
        return Score(found.score[:k], found.information[:k, :k])


def seen(runs: Sequence[Score], structure: Structure) -> list[Score]:
    """Score and information of each run, its own structure integrated out."""
    return [Score(*structure.seen(run)) for run in runs]


def contrast(test: Score, reference: Score, structure: Structure) -> Contrast:
    """Contrast of test runs with reference runs, given their totals and the `structure` of the reference."""
    return _without_common(test, test.information, total([test, reference]), structure)


def difference(a: Score, b: Score, structure: Structure) -> Contrast:
    """Contrast of session B with session A, given their totals and the `structure` of both."""
    half = Score(0.5 * (b.score - a.score), 0.25 * (a.information + b.information))
    return _without_common(half, 0.5 * (b.information - a.information), total([a, b]), structure)


def _without_common(score: Score, mixed: FloatArray, common: Score, structure: Structure) -> Contrast:
    """`score` and the common level with u integrated out; `mixed` (m, m) is the information between delta and theta."""
    prior = structure.precision
    inverse = _inverse(common.information + np.diag(prior))
    carry, level = mixed @ inverse, prior[:, None] * inverse
    return Contrast(Score(score.score - carry @ common.score, _symmetric(score.information - carry @ mixed.T)),
                    Score(level @ common.score, _symmetric(np.diag(prior) - level * prior)), carry * prior)


def _symmetric(square: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (square + square.T))


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
