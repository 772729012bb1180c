"""Where a fit starts: filtered motion, its least squares, and noise levels as neighbouring samples show them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.gauss_newton import State
from estimator.latent import LatentProblem, Latents, Noise
from estimator.mechanism import Mechanism
from estimator.options import FitOptions
from estimator.search import EXACT_ENCODER
from estimator.signals import quantum, white_noise_level
from estimator.signalset import SignalSet, differentiate
from estimator.wls import driven_first, stack_regressors, weighted_least_squares

FloatArray = NDArray[np.float64]


def start_state(problem: LatentProblem, signals: list[SignalSet], mechanism: Mechanism, options: FitOptions,
                free: NDArray[np.bool_], beta: FloatArray) -> State:
    """Filtered motion, its least squares fit and rough noise levels."""
    rate = signals[0].rate_hz
    cutoff = options.cutoff(rate)
    motions = [differentiate(s, mechanism, min(2.0 * cutoff, 0.4 * rate), options.filter_order, fused=True)
               for s in signals]
    z, tau = stack_regressors(signals, motions, mechanism, cutoff, options.filter_order)
    start = beta
    beta, covariance, sigma = weighted_least_squares(z, tau, free, start, 1.0)
    if mechanism.passive and mechanism.actuated:
        beta = driven_first(z, tau, free, start, mechanism)
        sigma = np.maximum(np.sqrt(np.mean((tau - z @ beta) ** 2, axis=0)), 1e-3 * sigma)
    x = Latents(np.concatenate([k.q for k in motions]), np.concatenate([k.qd for k in motions]),
                problem.torque.copy())
    known = options.noise
    torque = np.maximum(sigma, [white_noise_level(problem.torque[:, j]) for j in range(mechanism.n)])
    if "torque_nm" in known:
        torque[list(mechanism.actuated)] = known["torque_nm"]
    if "passive_nm" in known:
        torque[list(mechanism.passive)] = known["passive_nm"]
    encoder = np.full(mechanism.n, np.inf)
    for j in np.flatnonzero(problem.has_encoder):
        given = options.encoder_noise(int(j))
        encoder[j] = max(encoder_level(problem.angles[:, j]), 1e-7) if given is None else max(given, EXACT_ENCODER)
    gyro = accel = np.inf
    if problem.has_imu:
        gyro = known.get("gyro_radps", max(white_noise_level(problem.gyro), 1e-6))
        accel = known.get("accel_mps2", max(white_noise_level(problem.ax), white_noise_level(problem.ay), 1e-5))
    return State(x, beta, Noise(torque, encoder, gyro, accel), covariance)


def encoder_level(angle: FloatArray) -> float:
    """What differences between neighbours show of an encoder's error: its quantum, or white noise."""
    return max(white_noise_level(angle), quantum(angle) / np.sqrt(12.0))


def noise_floors(problem: LatentProblem, mechanism: Mechanism, beta: FloatArray) -> Noise:
    """Levels below which no estimate may fall: they only keep the equations solvable."""
    scale = max(float(np.std(problem.torque)), 1e-3 * float(np.max(np.abs(beta), initial=0.0)) * mechanism.gravity_mps2,
                1e-6)
    encoder = np.full(mechanism.n, np.inf)
    for j in np.flatnonzero(problem.has_encoder):
        encoder[j] = max(0.7 * encoder_level(problem.angles[:, j]), 1e-8)
    gyro = accel = 0.0
    if problem.has_imu:
        gyro = 0.7 * white_noise_level(problem.gyro)
        accel = 0.7 * max(white_noise_level(problem.ax), white_noise_level(problem.ay))
    return Noise(np.full(mechanism.n, 2e-3 * scale), encoder, max(gyro, 1e-6), max(accel, 1e-5))
