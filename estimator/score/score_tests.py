"""Score tests: what a small effect of each kind would gain, nominal parameters and motion projected out.

At a fit, the derivative of the log likelihood by an effect's size (its score) has mean zero unless the effect
is there. The latents are eliminated exactly (Schur complement); the nominal parameters are projected out over
the pooled runs. Runs are independent, samples are not: the scatter of scores between runs sets how much the
white-noise variance is too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, fdtrc, fdtri  # scipy.stats takes a second more to import

from daq import BoolArray, FloatArray, IndexArray
from estimator.numerics import pseudo_inverse
from estimator.score.score import HIDDEN, Score, total

ALPHA = 0.01
"""p-value, over all that is tested together, below which something is there."""
RUNS = 8
"""Runs whose scatter is known well. The scatter that all columns share weighs as much as so many runs of a column's
own."""


@dataclass(frozen=True)
class ScoreTests:
    """Efficient scores of all candidate columns, by run and pooled."""

    by_run: FloatArray
    """(R, c)"""
    score: FloatArray
    """(c,)"""
    information: FloatArray
    """(c, c)"""
    inflation: FloatArray
    """(c,) how much the scores scatter between runs over what white noise would make them."""
    freedom: float
    """Degrees of freedom of `inflation`."""
    before: FloatArray
    """(c,) information before the nuisance parameters were projected out."""
    carry: FloatArray
    """(nuisance, c) by how much a size moves the nuisance parameters, with the opposite sign"""

    @property
    def scatter(self) -> float:
        """Variance between runs of all that is tested, over that of white noise: the median of `inflation`."""
        return float(np.median(self.inflation))

    def gain(self, columns: IndexArray) -> float:
        """Twice the log likelihood that these columns would gain, over the scatter's inflation."""
        size = self.size(columns)
        return float(size @ self.score[columns]) / float(np.mean(self.inflation[columns]))

    def size(self, columns: IndexArray) -> FloatArray:
        """One-step estimate of the sizes of these columns."""
        return self._sizes(columns, self.score[columns])

    def explained(self, column: int, columns: IndexArray) -> float:
        """Share (0 to 1) of what `column` explains that `columns` explain, too: a squared multiple correlation."""
        own, common = self.information[column, column], self.information[columns, column]
        return float(self._sizes(columns, common) @ common / own) if own > 0.0 else 0.0

    def _sizes(self, columns: IndexArray, score: FloatArray) -> FloatArray:
        """Sizes of these columns for their `score`, without combinations that the data hardly show."""
        information = self.information[np.ix_(columns, columns)]
        scale = np.sqrt(np.maximum(self.before[columns], 1e-300))
        relative = information / np.outer(scale, scale)
        values, vectors = np.linalg.eigh(relative) if len(columns) > 1 else (relative[0], np.ones((1, 1)))
        good = values > np.maximum(HIDDEN, 1e-8 * values[-1])
        return np.asarray((vectors[:, good] / values[good]) @ (vectors[:, good].T @ (score / scale)) / scale)

    def p_value(self, columns: IndexArray) -> float:
        """p-value of the gain under no effect: F with the scatter's degrees of freedom."""
        k = len(columns)
        return float(fdtrc(k, self.freedom, max(self.gain(columns), 0.0) / k))

    def detectable(self, column: int, p: float, gain: float) -> float:
        """Size of one column that would give this p-value, and this gain, on average; inf for a hidden one."""
        if self.information[column, column] <= 0.0:
            return float("inf")
        needed = max(float(fdtri(1, self.freedom, 1.0 - p)), gain) * float(self.inflation[column])
        return float(np.sqrt(needed / self.information[column, column]))


def project(runs: Sequence[Score], nuisance: int) -> ScoreTests:
    """Efficient scores with the first `nuisance` parameters projected out over all `runs`."""
    whole = total(runs).information
    carry = pseudo_inverse(whole[:nuisance, :nuisance]) @ whole[:nuisance, nuisance:]
    score = np.array([r.score for r in runs])
    scores, informations = score[:, nuisance:] - score[:, :nuisance] @ carry, []
    for r in runs:
        cross = r.information[nuisance:, :nuisance] @ carry
        informations.append(r.information[nuisance:, nuisance:] - cross - cross.T
                            + carry.T @ r.information[:nuisance, :nuisance] @ carry)
    information, before = np.array(informations), np.diag(whole)[nuisance:].copy()
    hidden = np.einsum("rcc->c", information) < HIDDEN * before
    scores[:, hidden] = 0.0
    information[:, hidden], information[:, :, hidden] = 0.0, 0.0
    inflation, freedom = _inflation(scores, np.einsum("rcc->rc", information))
    return ScoreTests(scores, scores.sum(axis=0), information.sum(axis=0), inflation, freedom, before, carry)


def own_inflation(runs: Sequence[Score], free: BoolArray, least: float) -> FloatArray:
    """(m,) variance inflation of the model's first m parameters: their scatter between runs over that of white noise.

    Only `free` parameters; shrunk to their median, which is at least `least`. Efficient score of one parameter, with C
    the inverse of the pooled information: s_k = (C s)_k / C_kk.
    """
    out = np.full(free.size, least)
    which = np.flatnonzero(free)
    informations = np.array([r.information[np.ix_(which, which)] for r in runs])
    inverse = pseudo_inverse(informations.sum(axis=0))
    rows = inverse / np.diag(inverse)[:, None]
    scores = np.array([r.score[which] for r in runs]) @ rows.T
    out[which], _ = _inflation(scores, np.einsum("ki,rij,kj->rk", rows, informations, rows), least)
    return out


def determined(runs: Sequence[Score], free: BoolArray) -> BoolArray:
    """(m,) whether these runs determine each of the model's first m parameters; of `free` ones only.

    The others must leave a share 1 / (I_kk C_kk) of its information I_kk above HIDDEN; C is the pooled inverse of I.
    """
    out = np.zeros(free.size, bool)
    which = np.flatnonzero(free)
    information = total([r.of(which) for r in runs]).information
    out[which] = np.diag(information) * np.diag(pseudo_inverse(information)) < 1.0 / HIDDEN
    return out


def _inflation(scores: FloatArray, own: FloatArray, least: float = 1.0) -> tuple[FloatArray, float]:
    """Scatter of the scores (R, c), with information `own` (R, c), about their share of the pooled score, shrunk
    towards the columns' median."""
    runs = scores.shape[0]
    own = np.maximum(own, 1e-100)
    share = own / own.sum(axis=0)
    excess = scores - share * scores.sum(axis=0)
    if runs < 2:
        return np.full(scores.shape[1], least), float(RUNS)
    variance = np.sum(excess**2 / own, axis=0) / (runs - 1)
    common = max(least, float(np.median(variance)) / float(chdtri(runs - 1, 0.5) / (runs - 1)))
    inflation = (RUNS * common + (runs - 1) * variance) / (RUNS + runs - 1)
    return np.maximum(inflation, 1.0), float(RUNS + runs - 1)


def scatter_of(scores: FloatArray, own: FloatArray) -> FloatArray:
    """(c,) variance of scores (R, c) between R runs over that of white noise, with information `own` (R, c): the larger
    of a column's own and that shrunk to the median of all, and at least one."""
    own = np.maximum(own, 1e-100)
    share = own / own.sum(axis=0)
    variance = np.sum((scores - share * scores.sum(axis=0)) ** 2 / own, axis=0) / (len(scores) - 1)
    return np.maximum(_inflation(scores, own)[0], variance)


NO_TESTS = ScoreTests(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), 1.0, np.zeros(0), np.zeros((0, 0)))
"""Tests of nothing."""


def least_sigmas(tests: int) -> float:
    """Standard deviations (no unit) that the largest of so many normal errors exceeds with probability ALPHA, or
    less (Bonferroni)."""
    return float(np.sqrt(chdtri(1, ALPHA / max(1, tests))))
