"""`with_disturbance`: a fit with coloured torques as noise, unless a listed effect explains most of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from estimator.effects import Effect
from estimator.errors import FitError
from estimator.fit_errors import FIT_ERRORS
from estimator.fitting.disturbance import (
    Disturbance,
    alike,
    disturbance_likelihood,
    disturbed_problem,
    find_disturbance,
    most_disturbance,
    of_noise,
    predicts_worse,
)
from estimator.fitting.extension import ExtendedFit, extend, extended
from estimator.fitting.gauss_newton import iterate
from estimator.fitting.initial_guess import noise_floors
from estimator.fitting.omitted_effects import with_candidates
from estimator.fitting.profile_likelihood import suits
from estimator.free_runs import FittedModel
from estimator.likelihood import LatentProblem, State
from estimator.score import columns_of, project, score_at, small_effects
from estimator.signals import SignalSet

MOST_LEFT = 0.5
"""Share of a disturbance's slow part that may be left together with an effect that explains it."""
TRIED = 4
"""Effects that are tried, by the likelihood that their scores promise."""
ROUNDS = 3
"""Most times that levels of the disturbance are sought anew at the motion and parameters that followed from them."""


def with_disturbance(fitted: ExtendedFit) -> ExtendedFit:
    """The fit with coloured disturbances at the joints that ask for one.

    The fit stays as it was where no joint asks for one, where one takes as much torque as it may, where a fit with them
    does not converge, where its parameters predict worse, and where a listed effect explains most of them.
    """
    problem, state, signals, free, options, *_ = fitted
    if not state.converged or suits(signals, problem.mechanism, options) or options.torque_correlation:
        return fitted
    begin = of_noise(state.noise)
    for _ in range(ROUNDS):
        found = find_disturbance(disturbance_likelihood(signals, problem, state), begin, options)
        if not found.level.any() or float(found.level.max()) > 0.99 * most_disturbance(problem):
            return fitted
        if alike(begin, found):
            break
        begin = found
        problem = disturbed_problem(signals, problem)
        x = state.x if state.x.e is not None else replace(state.x, e=np.zeros_like(state.x.u))
        state = State(x, state.beta, found.put(state.noise), state.covariance, misfit=state.misfit)
        try:
            state = iterate(problem, state, free, options, noise_floors(problem, problem.mechanism, state.beta))
        except FitError:
            return fitted
        if not state.converged:
            return fitted
    mechanism, hold = problem.mechanism, problem.collocation.hold
    bare, kept = (FittedModel(mechanism, hold, one.beta) for one in (fitted.state, state))
    if problem.disturbed and predicts_worse(signals, options, bare, kept):
        return fitted
    cause = cause_of_disturbance(fitted, (begin, kept)) if problem.disturbed else None
    return fitted._replace(problem=problem, state=state) if cause is None else fitted._replace(said=(
        *fitted.said, f"a slow torque error is not taken for noise: {cause.key} explains most of it. "
        "Run legid diagnose"))


def cause_of_disturbance(fitted: ExtendedFit, disturbed: tuple[Disturbance, FittedModel]) -> Effect | None:
    """The listed effect that leaves less than MOST_LEFT of the slow part of a disturbance; None: there is none.

    `fitted` is without it, `disturbed` has it and the fit's model. Effects whose scores promise most are fitted in its
    place, and the likeliest disturbance is sought anew with each. One with which a second is predicted worse explains
    nothing: the fit without a disturbance may have gone astray, and the disturbance is small there.
    """
    (problem, state, signals, _, options, *_), (found, kept) = fitted, disturbed
    for effect in _promising(fitted):
        size = np.append(np.zeros(len(effect.sizes)), effect.usual or ())
        try:
            wide, again = extend(fitted, ((effect, size),), np.arange(size.size) < len(effect.sizes),
                                 state.noise.levels())
            likelihood = disturbance_likelihood(signals, wide, again, partial(_with_effect, problem, effect))
            left = find_disturbance(likelihood, of_noise(again.noise), options) if again.converged else found
        except FIT_ERRORS:
            continue
        with_effect = FittedModel(kept.mechanism, kept.hold, again.beta, (effect,), gear_ratio=options.gear_ratio)
        if _slow_part(left) < MOST_LEFT * _slow_part(found) and not predicts_worse(
                signals, options, kept, with_effect):
            return effect
    return None


def _slow_part(disturbance: Disturbance) -> float:
    """Spectral density at frequency zero, 2 sigma^2 T [(N m)^2 s], over all joints: the part that moves parameters.

    What is left at a time constant of a few samples is nearly white, and its level is of no account.
    """
    return float(2.0 * np.sum(disturbance.level**2 * disturbance.time_constant))


def _with_effect(problem: LatentProblem, effect: Effect, parts: Sequence[SignalSet]) -> LatentProblem:
    """The problem of parts of the record with an effect and a disturbance."""
    return extended(problem, parts, [effect]).with_disturbance()


def _promising(fitted: ExtendedFit) -> list[Effect]:
    """Effects of usual shapes whose scores promise most likelihood, the first TRIED."""
    problem, state, signals, free, options, *_ = fitted
    candidates = small_effects(problem)
    if not candidates:
        return []
    score = score_at(with_candidates(problem, signals, signals, state, candidates, options.gear_ratio), state)
    columns = columns_of(candidates)
    taken = np.concatenate([np.flatnonzero(free), *(free.size + own for own in columns)])
    tests = project([score.of(taken)], int(free.sum()))
    gains = [tests.gain(own) for own in columns]
    return [candidates[k].effect for k in np.argsort(gains)[::-1][:TRIED] if gains[k] > 0.0]
