"""Hold of the torque between samples, chosen by the likelihood where nobody states it.

Samples alone do not tell a torque that is held from one that ramps, or that a fast controller made. The motion between
them does: each way moves the links a little differently, and only one leaves nothing over. The marginal likelihood of
the four is compared at the noise levels of one fit, the latents integrated out (Laplace):

    log p = -(least weighted squares + log det H) / 2 + 2 sum_k log det D(q_k, beta)

H is the latents' matrix; the last term is the density of the motion, whose equation holds at two points an interval,
as one of accelerations (without it a smaller beta is always likelier); an interval whose friction is free has none.

The curve of a smooth torque is that of the fit's latents here, not of the measured torque as in a fit: the measured
torque's noise e enters as (1 + h(omega)) e, and costs the sum over frequencies of h, up to 18 in 2,000 samples,
whatever is true; so `linear` won by 9 where inertias were 1.4 standard deviations better with `smooth`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.errors import FitError
from estimator.fitting.newton_step import DIVERGED, newton_step
from estimator.likelihood import LatentProblem, Latents, Noise, State
from estimator.model import HOLDS, Mechanism
from estimator.numerics import eliminate
from estimator.signals import LEAST_SEGMENT, SignalSet, cut

FIRST = "smooth"
"""The hold of the fit at whose noise levels the others are compared."""
PRIOR = 5.0
"""Log-likelihood by which another hold must beat FIRST: a torque with a corner at every sample of the grid is made by a
plant on that grid, seldom by a rig's controller."""
EXCERPT = 2000
"""Samples that are looked at, or ..."""
SHARE = 4
"""... one in so many of a longer record: of each segment its first part."""
LOST = 100.0
"""A hold so far behind the best after the first step, in log-likelihood, is taken no further."""


class HoldChoice(NamedTuple):
    """The likeliest way in which torque acts between samples."""

    hold: str
    margin: float
    """Log-likelihood above that of the next."""
    next: str

    def __str__(self) -> str:
        if self.margin < PRIOR:
            return (f"these data hardly separate it from '{self.next}' (log-likelihood {self.margin:+.1f}); declare "
                    "hold under [sampling]")
        return f"the likeliest; the next, '{self.next}', has a log-likelihood {self.margin:.3g} below"


def choose_hold(signals: Sequence[SignalSet], mechanism: Mechanism, state: State, free: NDArray[np.bool_],
                fitted: LatentProblem) -> HoldChoice:
    """The likeliest of `HOLDS` given the fit of one of them; parameters that are not `free` stay."""
    total = fitted.total
    share = min(1.0, max(EXCERPT, total // SHARE) / total)
    parts = [cut(s, slice(0, max(LEAST_SEGMENT, round(share * len(s.time_s))))) for s in signals]
    index = np.concatenate([start + np.arange(len(s.time_s)) for s, start in
                            zip(parts, fitted.ends - [len(s.time_s) for s in signals], strict=True)])
    x = state.x.of(index)
    runners = {}
    for hold in HOLDS:
        problem = LatentProblem(parts, mechanism, hold).curved_by(x.u)
        runners[hold] = _Runner(problem, x, state.beta.copy(), state.noise.at(index), np.flatnonzero(free))
    found = {hold: runner.step() for hold, runner in runners.items()}
    ahead = max(found.values()) - LOST
    found |= {hold: runners[hold].step() for hold in HOLDS if found[hold] > ahead}
    found[FIRST] += PRIOR
    best, second, *_ = sorted(found, key=lambda hold: -found[hold])
    found[FIRST] -= PRIOR
    return HoldChoice(best, found[best] - found[second], second)


@dataclass
class _Runner:
    """One hold on its way to its own optimum: their difference is small, and nearly linear."""

    problem: LatentProblem
    x: Latents
    beta: FloatArray
    noise: Noise
    free: NDArray[np.intp]

    def step(self) -> float:
        """Log-likelihood predicted for the optimum, without the part that all holds share; one Gauss-Newton step.

        -inf where the equations cannot be solved. Raises `FitError` where the step diverges.
        """
        problem, index = self.problem, self.free
        point = problem.linearise(self.x, self.beta, self.noise)
        try:
            solved = eliminate(point.chain)
        except np.linalg.LinAlgError:
            return -np.inf
        step = newton_step(point, solved, index)
        size = np.linalg.slogdet(problem.mechanism.inertia_matrix(self.x.q[problem.left], self.beta))[1]
        held = (problem.motion_weight(self.noise) * problem.motion_level(self.noise)) ** 2
        squares = point.objective - step.fall
        self.x = self.x.moved(step.latents)
        self.beta[index] += step.beta
        if not (np.isfinite(self.beta).all() and np.isfinite(self.x.q).all()):
            raise FitError(DIVERGED)
        return float(-0.5 * (squares + solved.log_determinant()) + 2.0 * np.sum(size * held.mean(axis=0)))
