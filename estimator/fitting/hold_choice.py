"""How the torque acts between samples, chosen by the likelihood where nobody says it.

Samples alone do not tell a torque that is held from one that ramps, or that a fast controller made. The motion between
them does: each way moves the links a little differently, and only one leaves nothing over. The marginal likelihood of
the four is compared at the noise levels of one fit, the latents integrated out (Laplace):

    log p = -(least weighted squares + log det H) / 2 + 2 sum_k log det D(q_k, beta)

H is the latents' matrix; the last term is the density of the motion, whose equation holds at two points an interval,
as one of accelerations (without it a smaller beta is always likelier); an interval whose friction is free has none.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FitError
from estimator.likelihood import TIGHT, LatentProblem, State
from estimator.model import HOLDS, Mechanism
from estimator.numerics import eliminate
from estimator.signals import SignalSet

FIRST = "smooth"
"""The hold of the fit at whose noise levels the others are compared."""
PRIOR = 5.0
"""Log-likelihood by which another hold must beat FIRST: a torque with a corner at every sample of the grid is made by a
plant on that grid, seldom by a rig's controller, and a marginal likelihood in Laplace's form is no better than that.
(Measured on the encoder path under an open-loop torque: it prefers `linear` by 9, though with it all inertias are 1.4
standard deviations low, with `smooth` 0.4: so the choice is asked for by hold = "auto", and is not the default.)"""
STEPS = 2
"""Gauss-Newton steps from one hold's optimum to another's: their difference is small, and nearly linear."""


class HoldChoice(NamedTuple):
    """The likeliest way in which torque acts between samples."""

    hold: str
    margin: float
    """Log-likelihood above that of the next."""
    next: str

    def __str__(self) -> str:
        if self.margin < PRIOR:
            return f"this data hardly tells it from '{self.next}' (log-likelihood {self.margin:+.1f}); declare it"
        return f"the likeliest; the next, '{self.next}', has a log-likelihood {self.margin:.3g} below"


def choose_hold(signals: Sequence[SignalSet], mechanism: Mechanism, state: State, free: NDArray[np.bool_],
                fitted: LatentProblem) -> HoldChoice:
    """The likeliest of `HOLDS` given the fit of one of them; parameters that are not `free` stay."""
    found = {}
    for hold in HOLDS:
        problem = LatentProblem(signals, mechanism, hold)
        problem.stiction_variance = fitted.stiction_variance
        found[hold] = _log_likelihood(problem, state, np.flatnonzero(free))
    found[FIRST] += PRIOR
    best, second, *_ = sorted(found, key=lambda hold: -found[hold])
    found[FIRST] -= PRIOR
    return HoldChoice(best, found[best] - found[second], second)


def _log_likelihood(problem: LatentProblem, state: State, index: NDArray[np.intp]) -> float:
    """Of the record under `problem`'s hold, up to what all holds share; -inf where its equations cannot be solved."""
    x, beta = state.x, state.beta.copy()
    for step in range(STEPS + 1):
        point = problem.linearise(x, beta, state.noise)
        try:
            solved = eliminate(point.chain)
        except np.linalg.LinAlgError:
            return -np.inf
        product = solved.product()
        information = point.corner[np.ix_(index, index)] - product[np.ix_(1 + index, 1 + index)]
        gradient = point.gradient_beta[index] - product[1 + index, 0]
        step_beta = -np.linalg.lstsq(information, gradient)[0]
        if step == STEPS:
            break
        weights = np.zeros(point.chain.width)
        weights[0], weights[1 + index] = 1.0, step_beta
        x = x.moved(-solved.solution(weights))
        beta[index] += step_beta
    if not (np.isfinite(beta).all() and np.isfinite(x.q).all()):
        raise FitError("the fit ran away; the starting values are too far from the data")
    squares = point.objective - product[0, 0]
    size = np.linalg.slogdet(problem.mechanism.inertia_matrix(x.q[problem.left], beta))[1]
    held = (problem.motion_weight(state.noise) * (TIGHT * state.noise.torque)[:, None]) ** 2
    return float(-0.5 * (squares + solved.log_determinant()) + 2.0 * np.sum(size * held.mean(axis=0)))
