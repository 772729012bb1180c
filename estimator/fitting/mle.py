"""Maximum likelihood with one consistent latent motion: the default estimator.

Section IV of the paper with two changes: the latents are one trajectory whose rate and acceleration are its
derivatives (`estimator.model.collocation`), and noise levels are estimated instead of tuned by hand. With the right
ratio of noise levels this is total least squares along time, which does not shrink beta.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from daq import Dataset
from estimator.effects import SensorTimeSkew
from estimator.errors import FitError
from estimator.fitting.disturbance_cause import with_disturbance
from estimator.fitting.extension import ExtendedFit
from estimator.fitting.gauss_newton import iterate
from estimator.fitting.identifiability import undetermined
from estimator.fitting.imu_age import with_skew
from estimator.fitting.initial_guess import noise_floors
from estimator.fitting.latent_motion import converge_motion, marginal_of
from estimator.fitting.levels_by_run import with_levels_by_run
from estimator.fitting.loop_terms import scattered, with_loop_terms
from estimator.fitting.motion_search import first_fit, with_hold
from estimator.fitting.noise_levels import (
    colour,
    disturbance_levels,
    imu_levels,
    independence,
    torque_levels,
    unseen_levels,
    unseen_text,
)
from estimator.fitting.omitted_effects import omitted_effects, with_candidates
from estimator.fitting.prior import prior_at, prior_values
from estimator.fitting.run_levels import run_noise
from estimator.fitting.tolerances import with_scatter, with_tolerances, without_tolerances
from estimator.fitting.torque_colour import torque_colour
from estimator.fitting.unseen_torque import with_unseen_torque
from estimator.likelihood import LatentProblem
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.result import FitResult, LeftOut, Trajectory
from estimator.score import (
    agreement_of,
    nuisance_candidates,
    nuisances_of,
    score_at,
    score_runs,
    small_effects,
    steps_without,
    total,
)
from estimator.signals import SignalSet, angle_column, predicted_columns

CONFLICT_STEPS = 20
"""Steps without a prior, from the fit with it, that show whether the runs contradict it."""
CANDIDATES = with_hold, with_levels_by_run, with_unseen_torque, with_disturbance, with_loop_terms, with_skew
"""What a fit has where its records ask for it, in the order in which it is asked. The first is that of every verb."""


def fit_mle(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> FitResult:
    """Identify by marginal maximum likelihood; see the module's text. Raises `FitError`."""
    start = time.perf_counter()
    for aged in (True, False):
        fitted = first_fit(datasets, mechanism, options, aged)
        for add in CANDIDATES:
            fitted = add(fitted)
        if not fitted.age_s or any(isinstance(effect, SensorTimeSkew) for effect, _ in fitted.terms):
            break  # else no fit confirms that age
    stated, mechanism, options = mechanism, fitted.problem.mechanism, fitted.options
    if fitted.state.converged:  # runs' scores, and so the intervals, hold at the likeliest motion alone
        moved = converge_motion(*fitted.whole)
        fitted = fitted._replace(state=replace(fitted.state, x=moved.x, noise=moved.noise))
    result = result_of(fitted, 0.0)
    if result.converged:  # else there is no optimum to ask at
        with suppress(np.linalg.LinAlgError):  # a run that alone determines nothing at all
            result = _with_scores(result, fitted)
    prior = prior_values(result.mechanism, options.prior, *without_tolerances(result))
    result = replace(result, prior=prior, prior_conflict=_conflict(fitted, result), wall_s=time.perf_counter() - start)
    said = describe_smoothing_velocity(stated, mechanism), unseen_text(fitted.state.noise, mechanism.unit("N m"))
    return replace(result, assumptions=(*result.assumptions, *filter(None, said), *fitted.said))


def describe_smoothing_velocity(stated: Mechanism, mechanism: Mechanism) -> str | None:
    """Sentence on the estimated friction smoothing velocity; None where it is as stated."""
    wider = [j for j in range(mechanism.n) if mechanism.velocity_scales[j] > stated.velocity_scales[j]]
    if not wider:
        return None
    told = " and ".join(f"{mechanism.velocity_scales[j]:.2g} {mechanism.length_unit}/s at joint {j + 1}" for j in wider)
    return (f"friction smoothing velocity {told}, estimated; near rest the friction torque counts as unknown, with one "
            "value for each zero crossing of the velocity")


def _conflict(fitted: ExtendedFit, result: FitResult) -> float:
    """Standard deviations by which prior and runs disagree; 0 without a prior.

    sqrt(fall of -2 log p without the prior / number of known values), over the scatter between runs.
    """
    problem, state, _, free, options, *_ = fitted
    if not options.prior:
        return 0.0
    floors, begin = noise_floors(problem, result.mechanism, state.beta), replace(state, noise=state.noise.levels())
    try:
        both = [iterate(problem, begin, free, each, floors, CONFLICT_STEPS)
                for each in (options, replace(options, prior={}))]
        known, alone = (-2.0 * marginal_of(problem, s) for s in both)
    except FitError:
        return 0.0
    fall = known + prior_at(result.mechanism, options.prior, both[0].beta[: result.mechanism.p]).objective - alone
    own = state.covariance.diagonal()[: result.mechanism.p]
    scatter = without_tolerances(result)[1].diagonal() / np.maximum(own, 1e-300)
    spread = max(1.0, float(np.median(scatter[free]))) if free.any() else 1.0
    return float(np.sqrt(max(fall, 0.0) / (len(options.prior) * spread)))


def _with_scores(result: FitResult, fitted: ExtendedFit) -> FitResult:
    """`result` with all that one score of each run says.

    Its budget, in its covariance what its runs disagree about, and where asked for the effects that it lacks.
    """
    (problem, state), (_, _, signals, free, options, *_) = fitted.whole, fitted
    free = np.append(free, np.ones(state.beta.size - free.size, bool))
    known = prior_at(result.mechanism, options.prior, result.beta).information if options.prior else None
    small = small_effects(problem) if options.seeks_omitted or options.tolerances is not None else ()
    every = small if options.tolerances is None else nuisance_candidates(problem, options.tolerances)

    def of(own: list[SignalSet]) -> LatentProblem:
        return with_candidates(problem, signals, own, state, every, options.gear_ratio)

    scores = score_runs(signals, of, problem, state)
    seen = scores.of(np.arange(free.size + sum(one.width for one in small)))
    shown = scores.of(np.arange(free.size))
    if options.tolerances is not None:
        whole = total(scores.scores) if scores.scores else score_at(of(signals), state)
        result, scores = with_tolerances(result, whole, scores, (free, known), nuisances_of(
            every, problem, options.tolerances), options.tolerances)
    left_out = tuple(LeftOut(where, result.beta + step[: result.beta.size])
                     for where, step in steps_without(shown, free, known))
    covariance, agreement = agreement_of(scores.of(np.arange(free.size)), np.append(result.beta, state.beta[
        result.beta.size :]), result.covariance, free, known)
    result = with_scatter(replace(result, agreement=agreement, left_out=left_out), covariance)
    if agreement.disagree and result.loop:
        result = replace(result, loop=scattered(result.loop, scores.of(np.flatnonzero(free)).scores))
    omitted = omitted_effects(result, seen, free, small) if options.seeks_omitted else result.omitted
    return replace(result, omitted=omitted)


def _levels_given(mechanism: Mechanism, options: FitOptions) -> bool:
    """Whether the noise of every joint that counts is given: of the driven ones, or of all where there are none."""
    joints = mechanism.actuated or range(mechanism.n)
    return all(options.torque_noise(j, bool(mechanism.actuated)) is not None for j in joints)


def result_of(fitted: ExtendedFit, wall_s: float) -> FitResult:
    """The fit as others see it."""
    problem, state, signals, free, options, *_ = fitted
    x, beta, mechanism, chosen = state.x, state.beta, problem.mechanism, fitted.chosen
    qdd = np.concatenate([mechanism.forward_dynamics(x.q[s], x.v[s], x.u[s], beta)
                          for s in np.split(np.arange(problem.total), problem.ends[:-1])])
    tau = mechanism.inverse_dynamics(x.q, x.v, qdd, beta)
    residual = problem.torque - tau
    noise = torque_levels(state.noise, mechanism)
    passive = list(mechanism.passive)
    if passive:
        noise["passive_joint_nm"] = float(np.max(state.noise.torque[passive]))
    if problem.has_encoder.any():
        noise["encoder_rad"] = float(np.max(state.noise.encoder[problem.has_encoder]))
    if problem.has_imu:
        noise |= imu_levels(state.noise)
    noise |= disturbance_levels(state.noise) | unseen_levels(state.noise)
    trajectories = []
    for s, where in zip(signals, np.split(np.arange(problem.total), problem.ends[:-1])):
        measured, predicted = dict(s.imu), {}
        for j in np.flatnonzero(problem.has_encoder):
            column = angle_column(mechanism, int(j))
            measured[column], predicted[column] = s.angles[:, j], x.q[where, j]
        if s.imu:
            predicted |= predicted_columns(mechanism, x.q[where], x.v[where], qdd[where])
        trajectories.append(Trajectory(s.run, s.time_s, x.q[where], x.v[where], qdd[where], tau[where], s.torque,
                                       measured, predicted, None if x.e is None else -x.e[where]))
    assumptions: tuple[str, ...] = (
        f"torque acts between samples by the '{options.hold}' hold{f': {chosen}' if chosen else ''}",
        f"all noise is {colour(state.noise)}, Gaussian and {independence(options)}; levels "
        + ("as given" if _levels_given(mechanism, options) else
           "estimated from the data"),
        "the model's form is right" + ("" if options.tolerances is None else " within the tolerances")
        + ": its errors count as torque noise")
    riders = [f"IMU {k + 1} on link {place.link + 1}" for k, place in enumerate(mechanism.imus) if place.link]
    if problem.has_imu and riders:
        lengths = ", ".join(f"{length:g} m" for length in mechanism.link_lengths)
        assumptions += (f"{' and '.join(riders)} ride{'s' if len(riders) == 1 else ''} on links of exactly the lengths "
                        f"declared ({lengths} from link 1 on)",)
    return FitResult(mechanism, "mle", options.sensors, beta, state.covariance, noise,
                     np.sqrt(np.mean(residual**2, axis=0)), state.converged, state.iterations, problem.total, wall_s,
                     undetermined(mechanism, beta, state.covariance, free), assumptions, (), tuple(trajectories),
                     dict(options.fixed), options.hold, chosen and chosen.margin, loop=fitted.loop,
                     run_noise=run_noise(problem, signals, state.noise),
                     torque_colour=torque_colour(problem, state, signals)
                     if state.converged and mechanism.actuated else None)
