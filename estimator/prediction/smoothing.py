"""The smoother: the likeliest motion of one run under a model, all parameters held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import Dataset
from estimator.errors import FitError
from estimator.fitting import converge_motion, iterate, noise_floors, start_state
from estimator.free_runs import FittedModel, SmoothedRun
from estimator.likelihood import LatentProblem, State
from estimator.options import FitOptions
from estimator.signals import SignalSet, split_signals

SLACK = ((30.0, 6), (5.0, 6), (1.0, 25))
"""Factors on the passive joint's model error, and steps, on the way to the motion of a new run."""
LONGER = ((1000.0, 6), (200.0, 6), (40.0, 6), (16.0, 6), (8.0, 6), (4.0, 6), (2.0, 8), (1.4, 8), (1.0, 30))
"""... and where that leads to a motion that fits badly."""
LOOSE_ENCODER = 16.0
"""Most that an encoder's noise grows by together with a law that is less relaxes than found, and fits it worse."""
BAD = 3.0
"""Sum of squares over samples times channels above which a motion is tried again: about 1 where all is well."""


def smooth(model: FittedModel, data: Dataset, options: FitOptions, session_s: float = 0.0) -> SmoothedRun:
    """Likeliest motion of `data` under `model`, its parameters held, noise levels estimated from this run alone.

    Raises `FitError` where the equations cannot be solved.
    """
    signals = split_signals([data], model.mechanism, replace(options, hold=model.hold))
    return smooth_segments(model, data.name, signals, options, session_s)


def smooth_segments(model: FittedModel, run: str, signals: Sequence[SignalSet], options: FitOptions, session_s: float,
                    begin: State | None = None) -> SmoothedRun:
    """Motion like that of `smooth`, of the gap-free segments `signals` of the run named `run`; sought from `begin`, the
    state under a similar model, if there is one."""
    mechanism, options = model.mechanism, replace(options, hold=model.hold)
    problem = model.problem(signals, session_s)
    if begin is None:
        begin = start_state(problem, list(signals), mechanism, options, np.zeros(mechanism.p, bool), model.beta)
    beta = model.parameters.copy()
    state = State(begin.x, beta, begin.noise.levels(), np.zeros((beta.size,) * 2))
    floors = noise_floors(problem, mechanism, model.beta)
    state = iterate(problem, state, np.zeros(beta.size, bool), options, floors)
    return SmoothedRun(run, tuple(signals), problem, converge_motion(problem, state))


def smooth_under(problem: LatentProblem, begin: State, near: bool = False) -> State:
    """Likeliest motion of `problem` with the parameters and the noise of `begin` held, sought from the motion in it.

    A small model error, enforced at once from far off, does not converge: it comes down by the factors of `SLACK`. A
    motion that is `near`, such as that of which `problem` holds a replicate, needs none. What dry friction leaves open
    at rest is found anew where `problem` does not know it. Raises `FitError`.
    """
    tried = []
    relaxes = not np.array_equal(problem.relaxed(begin.beta, np.inf), begin.beta)
    for path in (SLACK[-1:] if near else LONGER if relaxes else SLACK, LONGER):
        try:
            state = _converged(problem, begin, path)
        except FitError as error:
            failure = error
            continue
        tried.append((per_value(problem, state), state))
        if tried[-1][0] < BAD or (relaxes and path is LONGER):
            break
    if not tried:
        raise failure
    return min(tried, key=lambda t: t[0])[1]


def _converged(problem: LatentProblem, begin: State, path: Sequence[tuple[float, int]]) -> State:
    """The motion that is reached from `begin` along a path of slacks, of the passive joint and of relaxes laws."""
    noise = begin.noise.levels()
    state = State(begin.x, begin.beta.copy(), noise, begin.covariance)
    for slack, limit in path:
        torque = noise.torque.copy()
        torque[list(problem.mechanism.passive)] *= slack
        state.beta = problem.relaxed(begin.beta, slack)
        relaxes = not np.array_equal(state.beta, begin.beta)
        encoder = noise.encoder * min(slack, LOOSE_ENCODER) if relaxes else noise.encoder
        state.noise = replace(noise, torque=torque, encoder=encoder)
        state = converge_motion(problem, state, limit)
    return state


def per_value(problem: LatentProblem, state: State) -> float:
    """Sum of squares over samples times channels; inf where it is no number."""
    channels = problem.n + int(problem.has_encoder.sum()) + 3 * problem.imu_count
    value = problem.motion_equations(state.x, state.beta, state.noise).objective / (channels * problem.total)
    return value if np.isfinite(value) else np.inf
