"""Starting values of a fit: filtered motion, its least squares, and noise levels as neighbouring samples show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.errors import FitError
from estimator.fitting.prior import combined
from estimator.fitting.profile_likelihood import EXACT_ENCODER
from estimator.fitting.wls import driven_first, stack_regressors, weighted_least_squares
from estimator.likelihood import LatentProblem, Latents, Noise, State
from estimator.model import STEPPED, Mechanism
from estimator.options import FitOptions
from estimator.signals import Kinematics, SignalSet, differentiate

ACTIVE = 0.5
"""Least noise of a torque over its activity from sample to sample: of a controller with two ticks a sample 0.6."""
GENTLE = 0.15
"""Share of the usual cutoff that `gentle_start` leaves of the motion; from 0.1 to 0.2 its fits end in one place."""


def start_state(problem: LatentProblem, signals: list[SignalSet], mechanism: Mechanism, options: FitOptions,
                free: NDArray[np.bool_], beta: FloatArray) -> State:
    """Filtered motion, its least squares fit and rough noise levels."""
    cutoff = options.cutoff(signals[0].rate_hz)
    motions = start_motions(signals, mechanism, options)
    z, tau = stack_regressors(signals, motions, mechanism, cutoff, options.filter_order)
    start = beta
    beta, covariance, sigma = weighted_least_squares(z, tau, free, start, 1.0)
    if mechanism.passive and mechanism.actuated:
        beta = driven_first(z, tau, free, start, mechanism)
        sigma = np.maximum(np.sqrt(np.mean((tau - z @ beta) ** 2, axis=0)), 1e-3 * sigma)
    if options.prior:
        beta = combined(mechanism, options.prior, beta, signals[0].rate_hz / cutoff * covariance)
    shown = problem.shown
    torque = np.maximum(sigma, shown.torque)
    for j in range(mechanism.n):
        declared = options.torque_noise(j, j in mechanism.actuated)
        torque[j] = torque[j] if declared is None else declared
    encoder = np.full(mechanism.n, np.inf)
    for j in map(int, np.flatnonzero(problem.has_encoder)):
        given = options.encoder_noise(j)
        encoder[j] = max(shown.encoder[j], 1e-7) if given is None else max(given, EXACT_ENCODER)
    gyro, accel = shown.gyro.copy(), shown.accel.copy()
    for k in range(problem.imu_count):
        given = options.gyro_noise(k)
        gyro[k] = max(shown.gyro[k], 1e-6) if given is None else given
        for i in range(2):
            given = options.accel_noise(i, k)
            accel[k, i] = max(shown.accel[k, i], 1e-5) if given is None else given
    return State(_latents(problem, motions), beta, Noise(torque, encoder, gyro, accel, options.accel_correlation,
                                joint_correlation(mechanism, options)), covariance)


def start_motion(problem: LatentProblem, signals: Sequence[SignalSet], mechanism: Mechanism, options: FitOptions
                 ) -> Latents:
    """Filtered motion, with the measured torque: that of `start_state`."""
    return _latents(problem, start_motions(signals, mechanism, options))


def start_motions(signals: Sequence[SignalSet], mechanism: Mechanism, options: FitOptions) -> list[Kinematics]:
    rate = signals[0].rate_hz
    cutoff = min(2.0 * options.cutoff(rate), 0.4 * rate)
    return [differentiate(s, mechanism, cutoff, options.filter_order, fused=True) for s in signals]


def _latents(problem: LatentProblem, motions: Sequence[Kinematics]) -> Latents:
    return Latents(np.concatenate([k.q for k in motions]), np.concatenate([k.qd for k in motions]),
                   problem.torque.copy())


def joint_correlation(mechanism: Mechanism, options: FitOptions) -> FloatArray | None:
    """(n, n) declared correlation of the joints' torques, passive joints uncorrelated; None where none is declared.

    Raises `FitError` where it has not one row for each driven joint.
    """
    if not options.torque_correlation:
        return None
    driven = sorted(mechanism.actuated)
    if len(options.torque_correlation) != len(driven):
        raise FitError(f"torque_correlation has {len(options.torque_correlation)} rows, {mechanism.name} has "
                       f"{len(driven)} driven joints: give one row for each")
    out = np.eye(mechanism.n)
    out[np.ix_(driven, driven)] = options.torque_correlation
    return out


def gentle_start(problem: LatentProblem, signals: list[SignalSet], mechanism: Mechanism, options: FitOptions,
                 free: NDArray[np.bool_], beta: FloatArray) -> State:
    """Start from slow motion alone, with noise levels at its residuals, for a model that is far wrong.

    Model error is smallest in slow motion. The usual start ends at beta = 0 there. (Measured on a gear that twists by
    0.3 rad/(N m): beta1 is 0.016 from the usual start, 0.173 from this one, true 0.181.)
    """
    slow = replace(options, cutoff_hz=GENTLE * options.cutoff(signals[0].rate_hz))
    state = start_state(problem, signals, mechanism, slow, free, beta)
    noise, still = state.noise, np.zeros((problem.total, problem.block))
    nothing = np.zeros(0, dtype=np.intp)
    left = problem.residuals_after(problem.linearise(state.x, state.beta, noise), still, np.zeros(0), nothing)

    def level(r: FloatArray, least: float) -> float:
        return max(float(np.sqrt(np.mean(r * r))), least) if np.isfinite(least) else least

    torque, encoder = (np.array([level(left[k][:, j], least[j]) for j in range(problem.n)])
                       for k, least in (("torque", noise.torque), ("encoder", noise.encoder)))
    gyro, accel = noise.gyro.copy(), noise.accel.copy()
    for k in range(problem.imu_count):
        gyro[k] = level(left["gyro"][k], noise.gyro[k])
        accel[k] = [level(left["accel"][k, :, i], noise.accel[k, i]) for i in range(2)]
    state.noise = replace(noise, torque=torque, encoder=encoder, gyro=gyro, accel=accel)
    return state


def noise_floors(problem: LatentProblem, mechanism: Mechanism, beta: FloatArray) -> Noise:
    """Levels below which no estimate may fall.

    They keep the equations solvable. A torque's activity from sample to sample is noise where the hold lets it act
    otherwise than in steps: its sensor's noise, or a controller's steps of which the record holds only some.
    """
    scale = max(float(np.std(problem.torque)), 1e-3 * float(np.max(np.abs(beta), initial=0.0)) * mechanism.gravity_mps2,
                1e-6)
    shown = problem.shown
    torque = np.full(mechanism.n, 2e-3 * scale)
    if problem.collocation.hold not in STEPPED:
        torque = np.maximum(torque, ACTIVE * shown.torque)
    return Noise(torque, np.maximum(0.7 * shown.encoder, 1e-8),
                 np.maximum(0.7 * shown.gyro, 1e-6), np.maximum(0.7 * shown.accel, 1e-5))
