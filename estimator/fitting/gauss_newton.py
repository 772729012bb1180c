"""`descend`: Gauss-Newton on motion, parameters and noise together, by policies; `iterate`: the usual ones.

Each step eliminates the latents exactly. A search is this loop times three policies: which share of a step is taken
(`damping`), how the noise is renewed (`noise_update`), and when it ends (`stopping`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from daq import BoolArray, IndexArray
from estimator.errors import FitError
from estimator.fitting.damping import SwingDamping, shortened
from estimator.fitting.newton_step import DIVERGED, NewtonStep, Taken, newton_step
from estimator.fitting.noise_update import NoiseUpdate
from estimator.fitting.prior import Known, Prior, prior_at
from estimator.fitting.stopping import SmallSteps
from estimator.likelihood import LatentProblem, Latents, Linearised, Noise, State
from estimator.numerics import Swept, eliminate
from estimator.options import FitOptions

MAX_ITERATIONS = 60
"""Most steps of a search; one that ends there has not converged, which every verb says."""
MARGIN = 1.1
"""Factor on the misfit that a step predicts at the samples: the Gauss points add to it, and it may still grow."""
LEAST_VARIANCE = 1e-300
"""Of a parameter, so that steps over standard deviations are numbers."""


class Damping(Protocol):
    """Share of a step that is taken."""

    def next(self, iteration: int, objective: float, step: NewtonStep, anew: bool) -> float:
        """Share (0, 1]; 0 ends the search."""


class Renewal(Protocol):
    """Renewal of a state's noise by its residuals."""

    @property
    def anew(self) -> bool:
        """Whether objectives of before and after the last renewal cannot be compared."""

    @property
    def change(self) -> float | None:
        """Largest relative change of a level in the last step; None while more than levels is sought."""

    def before(self, problem: LatentProblem, state: State, iteration: int) -> None:
        """Renew the state's noise before a step."""

    def after(self, problem: LatentProblem, state: State, taken: Taken, iteration: int) -> LatentProblem:
        """Renew it after a step; returns the problem, which may have changed."""


class Stop(Protocol):
    """End of a search."""

    def before(self, iteration: int, x: Latents, objective: float, anew: bool) -> bool:
        """Whether it ends before a step from x."""

    def at(self, step: NewtonStep, anew: bool) -> bool:
        """Whether it ends because of what a step promises."""

    def after(self, iteration: int, moved: float, objective: float, change: float | None) -> bool:
        """Whether it has converged with the last step."""


@dataclass
class Policies:
    """One search's: they remember its steps, so each search has its own."""

    noise: Renewal
    stop: Stop = field(default_factory=SmallSteps)
    damping: Damping = field(default_factory=SwingDamping)
    prior: Known = field(default_factory=dict)
    """What is known of parameters beforehand."""

    @classmethod
    def of(cls, options: FitOptions, floors: Noise | None, seeks_smoothing: bool = False, rough: bool = False
           ) -> Policies:
        """Those of a fit; see `NoiseUpdate` and `SmallSteps`."""
        return cls(NoiseUpdate(options, floors, seeks_smoothing), SmallSteps(rough), prior=options.prior)


def iterate(problem: LatentProblem, state: State, free: BoolArray, options: FitOptions,
            floors: Noise | None, limit: int = MAX_ITERATIONS) -> State:
    """`descend` by the usual policies; `floors` None keeps the noise levels. Raises `FitError`."""
    return descend(problem, state, free, Policies.of(options, floors), limit)


def descend(problem: LatentProblem, state: State, free: BoolArray, by: Policies, limit: int = MAX_ITERATIONS
            ) -> State:
    """State at which Gauss-Newton on latents and the `free` parameters ends after up to `limit` steps.

    Begins at `state`, which it leaves as it is. Raises `FitError`.
    """
    state, problem = replace(state, converged=False), problem.smoothed_over(state.smoothing)
    index = np.flatnonzero(free)
    for iteration in range(limit):
        state.iterations = iteration + 1
        by.noise.before(problem, state, iteration)
        point = _linearised(problem, state, index, by.prior)
        anew = by.noise.anew
        if by.stop.before(iteration, state.x, point.objective, anew):
            break
        solved = _eliminated(point, index)
        step = newton_step(point, solved, index)
        share = by.damping.next(iteration, point.objective, step, anew)
        if share == 0.0 or by.stop.at(step, anew):
            break
        moved = _move(problem, state, step, index, share)
        problem = by.noise.after(problem, state, Taken(point, solved, step, index, moved), iteration)
        state.converged = by.stop.after(iteration, moved, point.objective, by.noise.change)
        if state.converged:
            break
        del point, solved, step  # before the next ones are made: they are large
    return state


def _linearised(problem: LatentProblem, state: State, index: IndexArray, prior: Known) -> Linearised:
    """The normal equations at a state, without parameters where none is free."""
    if not index.size:
        return problem.motion_equations(state.x, state.beta, state.noise)
    predicted = None if state.misfit is None else MARGIN * problem.total * state.misfit
    point = problem.linearise(state.x, state.beta, state.noise, predicted)
    if prior:
        point = with_prior(point, prior_at(problem.mechanism, prior, state.beta[: problem.mechanism.p]))
    return point


def _eliminated(point: Linearised, index: IndexArray) -> Swept:
    try:
        return eliminate(point.chain)
    except np.linalg.LinAlgError:
        raise FitError("the equations of the fit became singular; the motion is not excited enough" if index.size else
                       "the equations of the motion became singular") from None


def _move(problem: LatentProblem, state: State, step: NewtonStep, index: IndexArray, share: float) -> float:
    """Take a `share` of a step; returns its length in standard deviations."""
    angles = step.latents[:, : problem.n]
    damping = shortened(angles, share)
    state.x = state.x.moved(damping * step.latents)
    state.beta = state.beta.copy()
    state.beta[index] += damping * step.beta
    state.covariance = np.zeros((state.beta.size, state.beta.size))
    state.covariance[np.ix_(index, index)] = step.covariance
    if not np.isfinite(state.beta).all():
        raise FitError(DIVERGED)
    if not index.size:
        return 0.0  # the levels alone end it: single angles can swing for ever, at the knots of a table
    std = np.sqrt(np.maximum(np.diag(step.covariance), LEAST_VARIANCE))
    return damping * float(np.max(np.abs(step.beta) / std))


def with_prior(point: Linearised, prior: Prior) -> Linearised:
    """The normal equations at `point` with those of a prior of its first p parameters."""
    p = prior.gradient.size
    corner, gradient = point.corner.copy(), point.gradient_beta.copy()
    corner[:p, :p] += prior.information
    gradient[:p] += prior.gradient
    return replace(point, objective=point.objective + prior.objective, corner=corner, gradient_beta=gradient)
