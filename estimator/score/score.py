"""`Score`: score and information of a record at one model, its motion eliminated; `score_at` makes it.

The log likelihood near a model is a quadratic in its parameters and in the sizes of everything that may be added to it:
s^T theta - theta^T I theta / 2. Score s and information I hold all that small changes of the model can say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq import FloatArray, IndexArray
from estimator.likelihood import Candidate, LatentProblem, State
from estimator.numerics import eliminate

HIDDEN = 1e-5
"""Share of the information about a column, or a combination of columns, below which nothing is left of it after others
are projected out: it is not tested, and its size is not determined."""


@dataclass(frozen=True)
class Score:
    """Score and information over m columns: parameters first, then the sizes of candidates."""

    score: FloatArray
    """(m,) derivative of the log likelihood"""
    information: FloatArray
    """(m, m)"""

    def of(self, columns: IndexArray) -> Score:
        """Score of these `columns` (k,), the others held at zero."""
        return Score(self.score[columns], self.information[np.ix_(columns, columns)])

    def along(self, basis: FloatArray) -> Score:
        """Score of the k sizes that move all columns by `basis` (m, k) each."""
        return Score(basis.T @ self.score, basis.T @ self.information @ basis)

    def gain(self) -> float:
        """Fall of -2 log likelihood by the likeliest size of all columns."""
        return float(self.size() @ self.score)

    def predicted_gain(self, others: Score) -> float:
        """Fall of -2 log predictive density by sizes that `others` give, with their uncertainty; no change has zero.

        With J and r the information and score of `others`, I and s those of this one:
        (r + s)^T (J + I)^-1 (r + s) - r^T J^-1 r + log(|J| / |J + I|).
        """
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self.information) + np.diag(others.information), 1e-300))
        known = others.information * np.outer(scale, scale) + HIDDEN * np.eye(scale.size)
        both = known + self.information * np.outer(scale, scale)
        r, every = scale * others.score, scale * (others.score + self.score)
        return float(every @ np.linalg.solve(both, every) - r @ np.linalg.solve(known, r)
                     + np.linalg.slogdet(known)[1] - np.linalg.slogdet(both)[1])

    def without(self, basis: FloatArray) -> Score:
        """The same with the sizes along `basis` (m, k) fitted and projected out; columns of which nothing is left are
        zero."""
        carry = self.information @ basis @ self.along(basis).covariance()
        left = self.information - carry @ basis.T @ self.information
        score = self.score - carry @ (basis.T @ self.score)
        gone = np.diag(left) < HIDDEN * np.diag(self.information)
        score[gone], left[gone], left[:, gone] = 0.0, 0.0, 0.0
        return Score(score, left)

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


def total(parts: Sequence[Score]) -> Score:
    """Score of independent records together."""
    return Score(np.sum([p.score for p in parts], axis=0), np.sum([p.information for p in parts], axis=0))


def score_at(problem: LatentProblem, state: State) -> Score:
    """Score over the problem's parameters, sizes and candidates at the smoothed motion in `state`.

    A passive joint's misfit counts as in a model that is right, with at most one variance a sample: under a model that
    is wrong, as it is of a rig that has changed, a larger one alone would move the parameters.
    """
    point = problem.linearise(state.x, state.beta, state.noise)
    product = eliminate(point.chain).product()
    return Score(product[1:, 0] - point.gradient_beta, point.corner - product[1:, 1:])


def columns_of(candidates: Sequence[Candidate]) -> list[IndexArray]:
    """Column numbers of each candidate, counted from the first candidate's."""
    stops = np.cumsum([c.width for c in candidates])
    return [np.arange(b - c.width, b) for c, b in zip(candidates, stops)]
