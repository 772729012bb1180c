"""`NoiseUpdate`: noise levels, stiction and friction smoothing velocities, renewed at each step of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from daq import FloatArray
from estimator.fitting.correlated_levels import correlation_of, excess_variance
from estimator.fitting.newton_step import Taken
from estimator.fitting.run_levels import renewed
from estimator.likelihood import (
    LatentProblem,
    Noise,
    NoiseScale,
    Process,
    State,
    effective_samples,
    find_smoothing,
    find_stiction,
    unseen_level,
)
from estimator.options import FitOptions
from estimator.signals import encoder_level

SAME_NOISE = 0.003
"""Noise levels that changed by less than this share leave what the latents take of each channel as it was."""
ANEW = 0.1
"""Change of a noise level beyond which objectives of before and after say nothing of a step."""
TORQUE_SHARE = 0.4
"""Most of a measured torque's spread that may be noise, see `most_noise`."""
SHOWN = 1.2
"""See `most_noise`."""
PASSIVE_SHARE = 0.1
"""Least model error of a passive joint as a share of the driven joints' noise. Without both shares a model that is far
wrong ends at beta = 0, where the passive joint's equation holds exactly and all torque is noise."""
AT_MOST = 0.99
"""Share of that from which on a level counts as the most that is allowed."""
REST_STEPS = 8
"""Steps in which samples at rest are updated; then they are fixed, so that the fit converges."""
ROUGH_STEPS = 2
"""First steps, whose noise levels are too rough to estimate the friction smoothing velocity."""
LEAST_FREEDOM = 0.002
"""Least share of a channel's samples that counts as not taken by the latents: a level divides by it."""
LEAST_FACTOR, MOST_FACTOR = 0.5, 3.0
"""Factors within which a level changes in one step: the first ones come from far off."""
QUIET = 0.15
"""Factor on `noise_floors` that makes of them a tenth of what a record's neighbouring samples show; see
`floors_under`."""
LEAST_UNSEEN = 0.01
"""Least level of a torque that no sample shows over the torque's noise: that of the equation's slack."""
PASSIVE_WAIT = 1
"""Steps without PASSIVE_EXPONENT."""
FALL_FACTOR, RISE_FACTOR = 0.985, 1.1
"""Changes of a level in a step, see PASSIVE_EXPONENT."""
PASSIVE_EXPONENT = 4.0
"""Power to which a passive joint's change of noise level is raised, after PASSIVE_WAIT steps.

Applies to a fall below FALL_FACTOR a step, and with noise levels by run to a rise below RISE_FACTOR. Without it a level
that tends to zero falls by 4 % a step. It is off where no joint is driven: two accelerated levels oscillate. (Measured
on legs of 10 s with a gyro of 0.02 or 0.05 rad/s: without it 2 or 7 of 8 fits do not converge in 60 steps.)"""


@dataclass
class NoiseUpdate:
    """Renewal of the noise at each step of one search, for all that `options` leave open.

    `floors` None keeps the noise levels. `seeks_smoothing`: friction's smoothing velocity is estimated, too; until it
    is found, what dry friction leaves open is one draw a sample. Where runs have levels, those that differ are kept.
    Stiction that neither the problem nor the state knows is found on the way.
    """

    options: FitOptions
    floors: Noise | None
    seeks_smoothing: bool = False
    _change: float = 0.0
    _finds_stiction: bool = False
    _one_per_crossing: bool = True
    _found_smoothing: bool = False
    _dof: Mapping[str, FloatArray] | None = field(default=None, repr=False)
    """`effective_samples` of the last step at which levels had changed."""

    @property
    def anew(self) -> bool:
        """Whether objectives of before and after the last renewal cannot be compared."""
        return self._change > ANEW

    @property
    def change(self) -> float | None:
        """Largest relative change of a level in the last step; None while friction's smoothing velocity is sought."""
        return None if self.seeks_smoothing else self._change

    def before(self, problem: LatentProblem, state: State, iteration: int) -> None:
        """Update stiction in the state, before a step."""
        if iteration == 0:
            self._finds_stiction = problem.stiction(state.noise) is None
            self._one_per_crossing = not self.seeks_smoothing
        if self._finds_stiction and (iteration < REST_STEPS or self._found_smoothing):
            stiction = find_stiction(problem, state.x.v, state.beta, self._one_per_crossing)
            state.noise = replace(state.noise, stiction=stiction)

    def after(self, problem: LatentProblem, state: State, taken: Taken, iteration: int) -> LatentProblem:
        """Update the state's noise by the residuals after a whole step; returns the problem with the smoothing found.

        Residuals after a whole step belong to the same noise levels as the degrees of freedom do. Mixing them with the
        residuals before it, or after a part of it, makes the levels swing with period two.
        """
        residuals = problem.residuals_after(taken.point, taken.step.latents, taken.step.beta, taken.free)
        if self.floors is not None:
            if self._dof is None or self._change > SAME_NOISE:
                self._dof = effective_samples(problem, taken.point, taken.solved.inverse_diagonal(), state.noise)
            self._found_smoothing = False
            if self.seeks_smoothing and iteration >= ROUGH_STEPS:
                problem = self._smoothed(problem, state, taken, residuals["torque"], iteration)
            self._change, floors = 0.0, floors_under(state.noise, self.floors)
            unseen = _unseen(problem, state, taken)
            if state.noise.scale is not None:
                state.noise, self._change = _with_scale(problem, state.noise, state.noise.scale, residuals, self._dof,
                                                        self.options, floors)
            noise = replace(_renewed(problem, state, self._dof, residuals, self.options, floors), unseen=unseen)
            self._change, state.noise = max(self._change, _change_of(state.noise, noise)), noise
        share_left = np.einsum("kj,kj->j", residuals["torque"] ** 2, 1.0 / problem.torque_variance(state.noise))
        if problem.disturbed:
            share_left += Process.of(state.noise, problem.dt).squares(residuals["e"], problem.ends)
        state.misfit = np.minimum(share_left / problem.total, 1.0)
        return problem

    def _smoothed(self, problem: LatentProblem, state: State, taken: Taken, residual: FloatArray, iteration: int
                  ) -> LatentProblem:
        """The problem with the likeliest smoothing velocity, which the state gets, too."""
        spread = np.einsum("kii->ki", taken.solved.inverse_diagonal())[:, 2 * problem.n : 3 * problem.n]
        state.smoothing = find_smoothing(problem, state.x, state.beta, state.noise, residual, spread)
        same = np.array_equal(state.smoothing, problem.mechanism.velocity_scales)
        self._found_smoothing = same or iteration + 1 >= REST_STEPS
        self.seeks_smoothing, self._one_per_crossing = not self._found_smoothing, self._found_smoothing
        return problem.smoothed_over(state.smoothing)


def most_noise(problem: LatentProblem, joint: int, floors: Noise, disturbed: bool) -> float:
    """Highest level of white noise that a driven joint's measured torque is allowed [N m].

    White noise is the sensor's: it does not move the joint. With a disturbance it is at most SHOWN times the noise
    between neighbouring samples. More than that moves the joint, and as sensor noise would bias the inertia low.
    """
    if disturbed:
        return SHOWN * encoder_level(problem.torque[:, joint]) + float(floors.torque[joint])
    return TORQUE_SHARE * float(problem.torque_spread[joint]) + float(floors.torque[joint])


def floors_under(noise: Noise, floors: Noise) -> Noise:
    """`floors` as they are, or a tenth of what neighbouring samples show where torque acts that no sample shows.

    There a sensor's activity from sample to sample is motion, not its noise.
    """
    if not noise.unseen.any():
        return floors
    return replace(floors, torque=QUIET * floors.torque, gyro=QUIET * floors.gyro, accel=QUIET * floors.accel)


def _unseen(problem: LatentProblem, state: State, taken: Taken) -> FloatArray:
    """(n,) renewed level of the torque that no sample shows."""
    old = state.noise.unseen
    if not old.any():
        return old
    found = unseen_level(problem, state.x, state.beta, state.noise, taken.solved)
    least = np.maximum(LEAST_FACTOR * old, LEAST_UNSEEN * state.noise.torque)
    return np.where(old > 0.0, np.clip(found, least, np.maximum(MOST_FACTOR * old, least)), 0.0)


def mistaken_torques(problem: LatentProblem, state: State, floors: Noise) -> list[int]:
    """Driven joints whose torque the fit took for noise as far as it may: no model of the rig."""
    return [j for j in problem.mechanism.actuated
            if state.noise.torque[j] > AT_MOST * most_noise(problem, j, floors, False)]


def _renewed(problem: LatentProblem, state: State, effective_dof: Mapping[str, FloatArray],
             residuals: Mapping[str, FloatArray], options: FitOptions, floors: Noise) -> Noise:
    """Noise of sigma^2 = sum r^2 / (samples - those `effective_dof` by the latents)."""
    taken = {kind: values.sum(axis=0) for kind, values in effective_dof.items()}
    residuals, old = whitened(residuals, state.noise.scale), state.noise
    torque = _torque_levels(problem, state, taken, residuals["torque"], options, floors)
    encoder = old.encoder.copy()
    for j in np.flatnonzero(problem.has_encoder):
        if options.encoder_noise(int(j)) is None:
            r = residuals["encoder"][:, j] / (1.0 if problem.spread is None else problem.spread[:, j])
            encoder[j] = _level(old, old.encoder[j], floors.encoder[j], r, float(taken["encoder"][j]))
    gyro, accel = old.gyro.copy(), old.accel.copy()
    for k in range(problem.imu_count):
        if options.gyro_noise(k) is None:
            gyro[k] = _level(old, old.gyro[k], floors.gyro[k], residuals["gyro"][k], float(taken["gyro"][k]))
        own, by_latents = residuals["accel"][k], taken["accel"][k]
        excess = accel_excess(old.accel[k], old.accel_correlation, own, by_latents)
        for i in range(2):
            if options.accel_noise(i, k) is None:
                accel[k, i] = _level(old, old.accel[k, i], floors.accel[k, i], np.sqrt(excess[i]) * own[:, i],
                                     excess[i] * float(by_latents[i, i]))
    return replace(old, torque=torque, encoder=encoder, gyro=gyro, accel=accel)


def _torque_levels(problem: LatentProblem, state: State, taken: Mapping[str, FloatArray], residual: FloatArray,
                   options: FitOptions, floors: Noise) -> FloatArray:
    """(n,) levels of the joints' torques from residuals (N, n), of which the latents took `taken`."""
    old, actuated, torque = state.noise, problem.mechanism.actuated, state.noise.torque.copy()
    weight = problem.torque_weight(old)
    excess = torque_excess(old, weight, residual, taken)
    for j in range(problem.n):
        if options.torque_noise(j, j in actuated) is None:
            waits = j in actuated or not actuated or state.iterations <= PASSIVE_WAIT
            r = np.sqrt(excess[j]) * (weight[:, j] * residual[:, j])
            torque[j] = _level(old, old.torque[j], floors.torque[j], r, excess[j] * float(taken["torque"][j]),
                               1.0 if waits else PASSIVE_EXPONENT, float(weight[:, j].sum()))
            if j in actuated:
                disturbed = problem.disturbed and bool(old.disturbance[j] > 0.0)
                torque[j] = min(torque[j], most_noise(problem, j, floors, disturbed))
    quietest = np.ones(problem.n) if old.scale is None else old.scale.torque.min(axis=0)
    driven = [torque[j] * quietest[j] for j in actuated]
    most = max((TORQUE_SHARE * float(problem.torque_spread[j]) for j in actuated), default=np.inf) or np.inf
    for j in problem.mechanism.passive:
        if driven:
            torque[j] = min(max(torque[j], PASSIVE_SHARE * min(driven)), most)
    return torque


def _level(old: Noise, previous: float, floor: float, residual: FloatArray, taken: float, exponent: float = 1.0,
           count: float | None = None) -> float:
    """The level that a channel's residual (N,) shows, of which the latents took so many samples; see
    PASSIVE_EXPONENT. `count` is the sum of the samples' weights."""
    size = residual.size if count is None else count
    freedom = max(size - taken, LEAST_FREEDOM * size)
    ratio = float(np.sqrt(np.vdot(residual, residual) / freedom)) / previous
    rises = old.scale is not None and 1.0 / FALL_FACTOR < ratio < RISE_FACTOR
    value = previous * ratio ** (exponent if ratio < FALL_FACTOR or rises else 1.0)
    return max(floor, float(np.clip(value, LEAST_FACTOR * previous, MOST_FACTOR * previous)))


def _change_of(old: Noise, new: Noise) -> float:
    """Largest relative change of a level."""
    own = old.unseen > 0.0
    pairs = ((new.torque, old.torque), (new.encoder, old.encoder), (new.unseen[own], old.unseen[own]),
             (np.append(new.accel, new.gyro), np.append(old.accel, old.gyro)))
    return max(float(np.max(np.abs(np.log(a[np.isfinite(a)] / b[np.isfinite(a)])), initial=0.0)) for a, b in pairs)


def whitened(residuals: Mapping[str, FloatArray], scale: NoiseScale | None) -> Mapping[str, FloatArray]:
    """Residuals over the noise scale of their run."""
    if scale is None:
        return residuals
    return {kind: residuals[kind] / values for kind, values in scale.by_kind() if kind in residuals}


def _with_scale(problem: LatentProblem, noise: Noise, before: NoiseScale, residuals: Mapping[str, FloatArray],
                effective_dof: Mapping[str, FloatArray], options: FitOptions, floors: Noise) -> tuple[Noise, float]:
    """`noise` with the noise scales of its runs renewed, and the largest relative change of one."""
    scale = renewed(problem, noise, before, residuals, effective_dof, options, floors)
    if scale is None:
        return replace(noise, scale=None), 0.0
    driven = list(problem.mechanism.actuated)
    if driven:  # a passive joint's level stays as far below the torque's in each run as it is in all
        quietest = np.min(noise.torque[driven] * scale.torque[:, driven], axis=1)
        scale.torque[:, list(problem.mechanism.passive)] = (quietest / np.min(quietest))[:, None]
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
