r"""`marginalise`: parameters with all nuisances at their tolerances integrated out, in one linear step.

Near the fit -2 log likelihood is quadratic in parameters b and sizes n, with information I and score s
(`estimator.score`). With n ~ N(0, T), T = diag(t^2), and b flat,

    I' = I_nn - I_nb I_bb^-1 I_bn,   s' = s_n - I_nb I_bb^-1 s_b,   V = (I' + T^-1)^-1,
    n = V s',   b = -G n,   cov b = I_bb^-1 + G V G',   G = I_bb^-1 I_bn.

V is computed as S (1 + S I' S)^-1 S, S = diag(t), which a tolerance of zero leaves finite. Since V = V I' V + V T^-1 V,
G V G' is what noise adds because the runs had to estimate n, and one term for each nuisance: JCGM 100 (GUM), 5.1, with
the correlations that the runs make.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq import BoolArray, FloatArray
from estimator.numerics import pseudo_inverse
from estimator.score.nuisances import Nuisance
from estimator.score.score import HIDDEN, Score
from estimator.score.score_tests import scatter_of

OUTLYING = 4.0
"""Squared score of a direction, over what noise and tolerances make of it on average, beyond which noise is larger."""
SEEN = 1e-8
"""Information about a direction, in units of the tolerances, below which the runs say nothing of it."""


@dataclass(frozen=True)
class Projected:
    """Nuisances with the parameters projected out."""

    score: FloatArray
    """(k,)"""
    information: FloatArray
    """(k, k)"""
    carry: FloatArray
    """(f, k) G, by how much each moves the free parameters, with the opposite sign"""


@dataclass(frozen=True)
class Marginal:
    """Step and covariance that nuisances add to f free parameters."""

    step: FloatArray
    """(f,) of the parameters"""
    sizes: FloatArray
    """(k,) likeliest nuisances"""
    noise: FloatArray
    """(f, f) covariance that the noise adds, because sizes are estimated from the same runs"""
    directions: FloatArray
    """(k, f) one row a nuisance, whose outer product is its part of the covariance"""


def projected(score: Score, free: BoolArray, prior: FloatArray | None = None) -> Projected:
    """Nuisances, the columns after the first `free` (m,) ones, with the free of those projected out.

    A `prior` (p, p) adds its information to that of the first p. Columns of which nothing is left have none.
    """
    m = free.size
    own, rest = np.flatnonzero(free), np.arange(m, score.score.size)
    known = score.information[:m, :m].copy()
    if prior is not None:
        known[: len(prior), : len(prior)] += prior
    inverse = pseudo_inverse(known[np.ix_(own, own)])
    cross = score.information[np.ix_(own, rest)]
    carry = inverse @ cross
    information = score.information[np.ix_(rest, rest)] - cross.T @ carry
    # at the optimum the parameters have no score but what steps not taken, or segments, leave; a prior has its own
    left = score.score[rest] - (carry.T @ score.score[own] if prior is None else 0.0)
    gone = np.diag(information) < HIDDEN * np.diag(score.information)[rest]
    left[gone], information[gone], information[:, gone] = 0.0, 0.0, 0.0
    return Projected(left, 0.5 * (information + information.T), carry)


def discounted(found: Projected, free: BoolArray, runs: Sequence[Score], nuisances: Sequence[Nuisance]
               ) -> tuple[Projected, Projected]:
    """`found` with the noise that its directions really have, and the same without those that contradict it; no
    tolerance is zero.

    Directions are the eigenvectors of the information in units of the tolerances. The variance of one's noise, in units
    of white noise, is the scatter of its score between `runs`, or segments of one. In the second result the excess of a
    score over what that and the tolerances allow counts as noise, too, so that it moves nothing.
    """
    size = np.array([one.tolerance for one in nuisances])
    values, axes = np.linalg.eigh(found.information * np.outer(size, size))
    values = np.maximum(values, 0.0)
    basis, own, rest = size[:, None] * axes, np.flatnonzero(free), np.arange(free.size, free.size + size.size)
    mixed = -found.carry @ basis  # what of the parameters is projected out of each direction
    scores = np.array([one.score[rest] @ basis + one.score[own] @ mixed for one in runs])
    informations = np.array([np.sum(basis * (one.information[np.ix_(rest, rest)] @ basis), axis=0)
                             + np.sum(mixed * (one.information[np.ix_(own, own)] @ mixed), axis=0)
                             + 2.0 * np.sum(mixed * (one.information[np.ix_(own, rest)] @ basis), axis=0)
                             for one in runs])
    along = basis.T @ found.score
    seen = values > SEEN
    square = np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0)
    noise = scatter_of(scores, informations) if len(runs) > 1 else np.ones(size.size)
    noise = np.where(seen, noise, 1.0)
    larger = np.where(square > OUTLYING * (noise + values), np.maximum(noise, square - values), noise)
    back = axes / size[:, None]
    plain, robust = (Projected(back @ (along / one), (back * (values / one)) @ back.T, found.carry)
                     for one in (noise, larger))
    return plain, robust


def marginalise(found: Projected, nuisances: Sequence[Nuisance]) -> Marginal:
    """The step of the parameters, and what each nuisance adds to their covariance."""
    size = np.array([one.tolerance for one in nuisances])
    values, vectors = np.linalg.eigh(found.information * np.outer(size, size))
    values = np.maximum(values, 0.0)
    left = found.carry * size @ vectors
    inverse = 1.0 / (1.0 + values)
    sizes = size * (vectors @ (inverse * (vectors.T @ (size * found.score))))
    directions = vectors @ (inverse * left).T
    return Marginal(-found.carry @ sizes, sizes, (left * (inverse - inverse**2)) @ left.T, directions)
