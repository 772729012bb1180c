"""`iterate`: the most likely motion, parameters and noise levels together, by Gauss-Newton.

Each step eliminates the latents exactly and renews the noise levels from the residuals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.errors import FitError
from estimator.fitting.correlated_levels import correlation_of, excess_variance
from estimator.fitting.prior import Prior, prior_at
from estimator.fitting.run_levels import renewed
from estimator.likelihood import (
    LatentProblem,
    Linearised,
    Noise,
    NoiseScale,
    Process,
    State,
    effective_samples,
    find_smoothing,
    find_stiction,
    unit_scale,
)
from estimator.numerics import Swept, eliminate, pseudo_inverse
from estimator.options import FitOptions
from estimator.signals import encoder_level

MAX_ITERATIONS = 60
TOLERANCE = 0.05
"""Converged when a step moves no parameter by more than this share of its standard deviation."""
ANGLE_TOLERANCE = 1e-6
"""Converged, where no parameter is free, when no angle moves by more than this [rad]."""
ROUGH = 0.5
"""As TOLERANCE, once, where only a start for a longer record is wanted: its standard deviations are smaller."""
SAME_NOISE = 0.003
"""Noise levels that changed by less than this share leave what the latents take of each channel as it was."""
RISE = 1.05
"""Growth of the objective above which a step was too long. (Measured: it doubled where a joint reversed close to a
sample; the next step gave 0.7.)"""
ANEW = 0.1
"""Change of a noise level beyond which objectives of before and after say nothing of a step."""
LOOSE_AFTER = 15
LOOSE = 0.15
"""After so many steps this share of a standard deviation will do: a joint that reverses, or rests, close to a
sample makes the last digits swing."""
TORQUE_SHARE = 0.4
"""Most of a measured torque's spread that may be noise, and ..."""
SHOWN = 1.2
"""See `most_noise`."""
PASSIVE_SHARE = 0.1
"""... the least model error of a passive joint as a share of the driven joints' noise. Without both a model that
is far wrong ends at beta = 0, where the passive joint's equation holds exactly and all torque is noise."""
REST_STEPS = 8
"""Steps in which samples at rest are updated; then they are fixed, so that the fit converges."""
ROUGH_STEPS = 2
"""First steps, whose noise levels are too rough to estimate the friction smoothing velocity."""
PASSIVE_WAIT = 1
FALL_FACTOR, RISE_FACTOR = 0.985, 1.1
PASSIVE_EXPONENT = 4.0
"""Power to which a passive joint's change of noise level is raised, after PASSIVE_WAIT steps.

Applies to a fall below FALL_FACTOR a step, and with noise levels by run to a rise below RISE_FACTOR. Without it a level
that tends to zero falls by 4 % a step. It is off where no joint is driven: two accelerated levels oscillate. (Measured
on legs of 10 s with a gyro of 0.02 or 0.05 rad/s: without it 2 or 7 of 8 fits do not converge in 60 steps.)"""
MARGIN = 1.1
"""Factor on the misfit that a step predicts at the samples: the Gauss points add to it, and it may still grow."""

DIVERGED = "the fit diverged; the starting values are too far from the data"


def iterate(problem: LatentProblem, state: State, free: NDArray[np.bool_], options: FitOptions,
            floors: Noise | None, limit: int = MAX_ITERATIONS, rough: bool = False, seeks_smoothing: bool = False,
          levels_by_run: bool = False) -> State:
    """State at which Gauss-Newton on latents and the `free` parameters ends, noise levels updated at each step.

    Begins at `state`, which it leaves as it is. `floors` None keeps the noise levels; `rough` ends the search at ROUGH.
    `seeks_smoothing`: friction's smoothing velocity is estimated, too; until it is found, what dry friction leaves open
    is one draw a sample. `levels_by_run`: runs may have noise levels of their own. Stiction that neither the problem
    nor the state knows is found on the way. Raises `FitError`.
    """
    state, problem = replace(state, converged=False), problem.smoothed_over(state.smoothing)
    index = np.flatnonzero(free)
    converged_steps, share, lowest, change, objective = 0, 1.0, np.inf, 0.0, np.inf
    before = np.zeros(index.size)
    effective_dof: Mapping[str, FloatArray] | None = None
    finds_stiction = problem.stiction(state.noise) is None
    one_per_crossing, found_smoothing = not seeks_smoothing, False
    for iteration in range(limit):
        state.iterations = iteration + 1
        if finds_stiction and (iteration < REST_STEPS or found_smoothing):
            stiction = find_stiction(problem, state.x.v, state.beta, one_per_crossing)
            state.noise = replace(state.noise, stiction=stiction)
        predicted = None if state.misfit is None else MARGIN * problem.total * state.misfit
        if index.size:
            point = problem.linearise(state.x, state.beta, state.noise, predicted_misfit=predicted)
            if options.prior:
                point = with_prior(point, prior_at(problem.mechanism, options.prior, state.beta[: problem.mechanism.p]))
        else:
            point = problem.motion_equations(state.x, state.beta, state.noise)
        try:
            solved = eliminate(point.chain)
        except np.linalg.LinAlgError:
            raise FitError("the equations of the fit became singular; the motion is not excited enough") from None
        step, step_beta, information, covariance = newton_step(point, solved, index)
        if iteration > 2:  # the first steps come from far off and their noise levels are rough
            along = float(step_beta @ information @ before)
            swings = along < -0.25 * float(before @ information @ before)
            share = max(0.1, 0.5 * share) if swings or point.objective > RISE * lowest else min(1.0, 1.2 * share)
            lowest = min(lowest, point.objective)
        if change > ANEW:
            lowest = point.objective
        before = step_beta
        damping = shortened(step[:, : problem.n], share)
        state.x = state.x.moved(damping * step)
        state.beta = state.beta.copy()
        state.beta[index] += damping * step_beta
        state.covariance = np.zeros((state.beta.size, state.beta.size))
        state.covariance[np.ix_(index, index)] = covariance
        if not np.isfinite(state.beta).all():
            raise FitError(DIVERGED)
        std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        moved = damping * float(np.max(np.abs(step_beta) / std, initial=0.0))
        if not index.size:
            moved = float(np.max(np.abs(step[:, : problem.n]))) / ANGLE_TOLERANCE * TOLERANCE
        residuals = problem.residuals_after(point, step, step_beta, index)
        if floors is not None:
            if effective_dof is None or change > SAME_NOISE:
                effective_dof = effective_samples(problem, point, solved.inverse_diagonal(), state.noise)
            found_smoothing = False
            if seeks_smoothing and iteration >= ROUGH_STEPS:
                spread = np.einsum("kii->ki", solved.inverse_diagonal())[:, 2 * problem.n : 3 * problem.n]
                found = find_smoothing(problem, state.x, state.beta, state.noise, residuals["torque"], spread)
                same = np.array_equal(found, problem.mechanism.velocity_scales)
                state.smoothing, problem = found, problem.smoothed_over(found)
                found_smoothing = same or iteration + 1 >= REST_STEPS
                seeks_smoothing, one_per_crossing = not found_smoothing, found_smoothing
            change = 0.0
            if levels_by_run and (state.noise.scale is not None or moved < ROUGH):
                state.noise, change = _with_scale(problem, state.noise, residuals, effective_dof, options, floors)
            change = max(change, _update_noise(problem, state, effective_dof, residuals, options, floors))
        share_left = np.einsum("kj,kj->j", residuals["torque"] ** 2, 1.0 / problem.torque_variance(state.noise))
        if problem.disturbed:
            share_left += Process.of(state.noise, problem.dt).squares(residuals["e"], problem.ends)
        state.misfit = np.minimum(share_left / problem.total, 1.0)
        enough = ROUGH if rough else TOLERANCE if iteration < LOOSE_AFTER else LOOSE
        overshot = point.objective > RISE * objective and iteration < LOOSE_AFTER
        still = moved < enough and change < (0.1 if rough else 0.01) and not seeks_smoothing and not overshot
        objective = point.objective
        converged_steps = converged_steps + 1 if still else 0
        del point, solved  # before the next ones are made: they are large
        if converged_steps >= (1 if rough else 2):
            state.converged = True
            break
    return state


def with_prior(point: Linearised, prior: Prior) -> Linearised:
    """The normal equations at `point` with those of a prior of its first p parameters."""
    p = prior.gradient.size
    corner, gradient = point.corner.copy(), point.gradient_beta.copy()
    corner[:p, :p] += prior.information
    gradient[:p] += prior.gradient
    return replace(point, objective=point.objective + prior.objective, corner=corner, gradient_beta=gradient)


def newton_step(point: Linearised, solved: Swept, index: NDArray[np.intp]
                ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Step of the latents (N, b), step of the parameters `index`, and their information and covariance.

    Raises `FitError` where they are not finite.
    """
    product = solved.product()
    information = point.corner[np.ix_(index, index)] - product[np.ix_(1 + index, 1 + index)]
    if not np.isfinite(information).all():
        raise FitError(DIVERGED)
    covariance = pseudo_inverse(information)
    step_beta = -covariance @ (point.gradient_beta[index] - product[1 + index, 0])
    weights = np.zeros(point.chain.width)
    weights[0], weights[1 + index] = 1.0, step_beta
    return -solved.solution(weights), step_beta, information, covariance


def most_noise(problem: LatentProblem, joint: int, floors: Noise, disturbed: bool) -> float:
    """Highest level of white noise that a driven joint's measured torque is allowed [N m].

    White noise is the sensor's: it does not move the joint. With a disturbance it is at most SHOWN times the noise
    between neighbouring samples. More than that moves the joint, and as sensor noise would bias the inertia low.
    """
    if disturbed:
        return SHOWN * encoder_level(problem.torque[:, joint]) + float(floors.torque[joint])
    return TORQUE_SHARE * float(problem.torque_spread[joint]) + float(floors.torque[joint])


def mistaken_torques(problem: LatentProblem, state: State, floors: Noise) -> list[int]:
    """Driven joints whose torque the fit took for noise as far as it may: no model of the rig."""
    return [j for j in problem.mechanism.actuated
            if state.noise.torque[j] > 0.99 * most_noise(problem, j, floors, False)]


def shortened(angles: FloatArray, share: float) -> float:
    """`share`, less where an angle would move by more than 0.5 rad: a linearisation means little there."""
    biggest = share * float(np.max(np.abs(angles)))
    return share if biggest < 0.5 else share * 0.5 / biggest


def _update_noise(problem: LatentProblem, state: State, effective_dof: Mapping[str, FloatArray],
                  residuals: Mapping[str, FloatArray], options: FitOptions, floors: Noise) -> float:
    """sigma^2 = sum r^2 / (samples - those `effective_dof` by the latents); returns the largest relative change.

    `residuals` are those after a whole step: they belong to the same noise levels as the degrees of freedom do.
    Mixing them with the residuals before it, or after a part of it, makes the levels swing with period two.
    """
    weight = problem.torque_weight(state.noise)
    effective_dof = {kind: values.sum(axis=0) for kind, values in effective_dof.items()}
    residuals = whitened(residuals, state.noise.scale)
    old, actuated = state.noise, problem.mechanism.actuated

    def level(r: FloatArray, gamma: float, floor: float, previous: float, exponent: float = 1.0,
              count: float | None = None) -> float:
        size = r.size if count is None else count
        freedom = max(size - gamma, 0.002 * size)
        ratio = float(np.sqrt(np.vdot(r, r) / freedom)) / previous
        rises = old.scale is not None and 1.0 / FALL_FACTOR < ratio < RISE_FACTOR
        value = previous * ratio ** (exponent if ratio < FALL_FACTOR or rises else 1.0)
        return max(floor, float(np.clip(value, previous / 2.0, previous * 3.0)))

    torque, encoder = old.torque.copy(), old.encoder.copy()
    excess = torque_excess(old, weight, residuals["torque"], effective_dof)
    for j in range(problem.n):
        if options.torque_noise(j, j in actuated) is None:
            r, count = weight[:, j] * residuals["torque"][:, j], float(weight[:, j].sum())
            waits = j in actuated or not actuated or state.iterations <= PASSIVE_WAIT
            exponent = 1.0 if waits else PASSIVE_EXPONENT
            torque[j] = level(np.sqrt(excess[j]) * r, excess[j] * float(effective_dof["torque"][j]), floors.torque[j],
                              old.torque[j], exponent, count)
            if j in actuated:
                disturbed = problem.disturbed and bool(old.disturbance[j] > 0.0)
                torque[j] = min(torque[j], most_noise(problem, j, floors, disturbed))
        if problem.has_encoder[j] and options.encoder_noise(int(j)) is None:
            r = residuals["encoder"][:, j] / (1.0 if problem.spread is None else problem.spread[:, j])
            encoder[j] = level(r, float(effective_dof["encoder"][j]), floors.encoder[j], old.encoder[j])
    quietest = np.ones(problem.n) if old.scale is None else old.scale.torque.min(axis=0)
    driven = [torque[j] * quietest[j] for j in actuated]
    most = max((TORQUE_SHARE * float(problem.torque_spread[j]) for j in actuated), default=np.inf) or np.inf
    for j in problem.mechanism.passive:
        if driven:
            torque[j] = min(max(torque[j], PASSIVE_SHARE * min(driven)), most)
    gyro, accel = old.gyro.copy(), old.accel.copy()
    for k in range(problem.imu_count):
        if options.gyro_noise(k) is None:
            gyro[k] = level(residuals["gyro"][k], float(effective_dof["gyro"][k]), floors.gyro[k], old.gyro[k])
        own, by_latents = residuals["accel"][k], effective_dof["accel"][k]
        excess = accel_excess(old.accel[k], old.accel_correlation, own, by_latents)
        for i in range(2):
            if options.accel_noise(i, k) is None:
                accel[k, i] = level(np.sqrt(excess[i]) * own[:, i], excess[i] * float(by_latents[i, i]),
                                    floors.accel[k, i], old.accel[k, i])
    state.noise = replace(old, torque=torque, encoder=encoder, gyro=gyro, accel=accel)
    pairs = [(torque, old.torque), (encoder, old.encoder), (np.append(accel, gyro), np.append(old.accel, old.gyro))]
    return max(float(np.max(np.abs(np.log(a[np.isfinite(a)] / b[np.isfinite(a)])), initial=0.0)) for a, b in pairs)


def whitened(residuals: Mapping[str, FloatArray], scale: NoiseScale | None) -> Mapping[str, FloatArray]:
    """Residuals over the noise scale of their run."""
    if scale is None:
        return residuals
    return {kind: residuals[kind] / values for kind, values in scale.by_kind() if kind in residuals}


def _with_scale(problem: LatentProblem, noise: Noise, residuals: Mapping[str, FloatArray],
                effective_dof: Mapping[str, FloatArray], options: FitOptions, floors: Noise) -> tuple[Noise, float]:
    """`noise` with the noise scales of its runs renewed, and the largest relative change of one."""
    scale = renewed(problem, noise, residuals, effective_dof, options, floors)
    if scale is None:
        return replace(noise, scale=None), 0.0
    driven = list(problem.mechanism.actuated)
    if driven:  # a passive joint's level stays as far below the torque's in each run as it is in all
        quietest = np.min(noise.torque[driven] * scale.torque[:, driven], axis=1)
        scale.torque[:, list(problem.mechanism.passive)] = (quietest / np.min(quietest))[:, None]
    before = noise.scale or unit_scale(problem.total, problem.n, problem.imu_count)
    change = max(float(np.max(np.abs(np.log(new / old)), initial=0.0))
                 for (_, new), (_, old) in zip(scale.by_kind(), before.by_kind(), strict=True))
    return replace(noise, scale=scale), change


def accel_excess(levels: FloatArray, rho: float, residual: FloatArray, by_latents: FloatArray) -> FloatArray:
    """(2,) see `excess_variance`, from the `levels` (2,) and residuals (N, 2) of both axes, correlated by `rho`, and
    what the latents take of them (2, 2)."""
    if rho == 0.0:
        return np.ones(2)
    products = residual.T @ residual + by_latents * np.outer(levels, levels)
    return excess_variance(np.array([[1.0, rho], [rho, 1.0]]),
                           correlation_of(products, np.full((2, 2), float(len(residual)))))


def torque_excess(noise: Noise, weight: FloatArray, residual: FloatArray, by_latents: Mapping[str, FloatArray]
                  ) -> FloatArray:
    """(n,) likewise of the joints' torques, from residuals (N, n) and the `weight` (N, n) that they have."""
    if noise.torque_correlation is None:
        return np.ones(noise.torque.size)
    r = weight * residual
    products = r.T @ r + by_latents["torque_products"] * np.outer(noise.torque, noise.torque)
    counts = weight.T @ weight
    np.fill_diagonal(counts, weight.sum(axis=0))
    return excess_variance(noise.torque_correlation, correlation_of(products, counts))
