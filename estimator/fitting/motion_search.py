"""Motion, parameters and noise levels that are likeliest under one hold, from readings alone: `search_motion`.

Before it, an IMU's age is taken off: `first_fit`. After it `with_hold` takes the likeliest hold: every verb begins with
both. `find_loop` wants values of loops alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import Dataset
from estimator.errors import FitError
from estimator.fitting.extension import ExtendedFit
from estimator.fitting.gauss_newton import Policies, descend
from estimator.fitting.hold_choice import FIRST, choose_hold
from estimator.fitting.imu_age import rough_age
from estimator.fitting.initial_guess import gentle_start, noise_floors, start_state
from estimator.fitting.loop_terms import find_loop_terms
from estimator.fitting.profile_likelihood import Searched, known_noise, search, suits
from estimator.fitting.warm_start import from_excerpt
from estimator.fitting.wls import free_mask
from estimator.likelihood import BatchProblem, LatentProblem, Latents, Noise, Records, State
from estimator.model import Mechanism
from estimator.options import AUTO, FitOptions
from estimator.result import LoopTerm
from estimator.signals import SignalSet, split_signals, with_earlier_imu

LEAST_AGE = (1e-3, 0.1)
"""Rough age of an IMU, in [s] and in samples, from which on its readings are moved before the fit; less is a term of
the fit."""


def find_loop(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, sure: Sequence[str]
              ) -> tuple[LoopTerm, ...]:
    """Values of `options.unknown_loop` by the motion of joints whose loop makes the torque; see `find_loop_terms`.
    Raises `FitError`."""
    return find_loop_terms(with_hold(first_fit(datasets, mechanism, options, aged=False)), sure)


def first_fit(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, aged: bool = True
              ) -> ExtendedFit:
    """The fit of `search_motion` under the stated hold, else FIRST, of runs whose IMU was moved by its age.

    Where the rig or a clock states the times that is 0, as it is if the IMU is not `aged`. A nominal age of the rig's
    leaves more open than that of a clock: within its bound the age is sought, too. Raises `FitError`.
    """
    signals, bound_s, age_s = split_signals(datasets, mechanism, options), max(d.clock_bound_s for d in datasets), 0.0
    least = max(LEAST_AGE[0], LEAST_AGE[1] / signals[0].rate_hz)
    if aged and (bound_s >= least or (options.hold == AUTO and not bound_s)):
        age_s = rough_age(signals, mechanism, options, *free_mask(mechanism, options))
        age_s *= abs(age_s) <= bound_s if bound_s else abs(age_s) >= least
        signals = [with_earlier_imu(s, age_s) for s in signals] if age_s else signals
    begin = replace(options, hold=FIRST) if options.hold == AUTO else options
    problem, state = search_motion(signals, mechanism, begin)
    return ExtendedFit(problem, state, signals, free_mask(mechanism, options)[0], replace(
        options, smoothing_velocity="given"), bound_s=bound_s, age_s=age_s)


def with_hold(fitted: ExtendedFit) -> ExtendedFit:
    """The fit under the likeliest hold, which is told, where none is stated."""
    problem, state, signals, _, options, *_ = fitted
    if options.hold != AUTO:
        return fitted
    chosen = choose_hold(fitted)
    options = replace(options, hold=chosen.hold)
    if chosen.hold != FIRST:
        problem, state = search_motion(signals, problem.mechanism, options, state)
    return fitted._replace(problem=problem, state=state, options=options, chosen=chosen)


def search_motion(signals: list[SignalSet], mechanism: Mechanism, options: FitOptions, near: State | None = None
                  ) -> tuple[LatentProblem, State]:
    """The likeliest motion, parameters and noise levels under one hold, from those `near` where there are any.

    A search that fails, or does not end, starts again from slow motion. Raises `FitError` where both fail.
    """
    problem, (free, beta) = LatentProblem(signals, mechanism, options.hold), free_mask(mechanism, options)
    seeks_smoothing = options.smoothing_velocity == AUTO and any(p.term == "coulomb" for p in mechanism.parameters)
    if suits(signals, mechanism, options):
        noise = known_noise(mechanism, options)
        spread = None if problem.spread is None else problem.spread[None]
        return problem, state_of(search(BatchProblem(mechanism, signals[0].rate_hz, options.hold, noise),
                                        Records(problem.angles[None], problem.torque[None], spread)), 0, noise)
    begin = start_state(problem, signals, mechanism, options, free, beta) if near is None else replace(
        near, noise=near.noise.levels())
    floors = noise_floors(problem, mechanism, begin.beta)
    warm = from_excerpt(problem, signals, options, free, begin, seeks_smoothing) if near is None else None
    found: State | None = None
    for gentle in (False, True):
        try:
            start = gentle_start(problem, signals, mechanism, options, free, beta) if gentle else warm or begin
            state = descend(problem, start, free, Policies.of(options, floors, seeks_smoothing))
            refuse_collapse(problem, state, mechanism)
        except FitError as error:
            failure = error
            continue
        found = state if found is None or state.converged else found
        if state.converged:
            break
    if found is None:
        raise failure
    return problem.smoothed_over(found.smoothing), found


def refuse_collapse(problem: LatentProblem, state: State, mechanism: Mechanism) -> None:
    """Raise where nearly all measured torque was put down to noise: then beta shrinks to nothing.

    With angles taken as exact and a large torque noise this is a maximum of the likelihood, and never the one
    that is meant (a drive with play, or time stamps that jitter, has larger angle errors than its encoder).
    """
    for j in mechanism.actuated:
        rms = float(np.std(problem.torque[:, j]))
        share = float(np.std(state.x.u[:, j] - problem.torque[:, j])) / max(rms, 1e-300)
        if rms > 0.0 and state.noise.torque[j] > 0.6 * rms and share > 0.5 and np.isfinite(state.noise.encoder).any():
            raise FitError(
                f"the fit puts the torque of joint {j + 1} down to noise; the angles carry more error than their "
                f"encoder shows ({np.min(state.noise.encoder):.2g} rad): declare it, play included, as encoder_rad "
                "under [noise], or lower rate_hz")


def state_of(searched: Searched, record: int, noise: Noise) -> State:
    """State that a search found for one of its records. Raises `FitError` where no search converged."""
    if not np.isfinite(searched.objective[record]):
        raise FitError("no search converged; the record is too short or too noisy")
    q, v, u = np.split(searched.x[record], 3, axis=-1)
    return State(Latents(q, v, u), searched.beta[record], noise, searched.covariance[record],
                 bool(searched.converged[record]), int(searched.steps[record]))
