"""Starting values of a fit: filtered motion, its least squares, and noise levels as neighbouring samples show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import BoolArray, FloatArray
from estimator.errors import FitError
from estimator.fitting.prior import combined
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
                free: BoolArray, beta: FloatArray) -> State:
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
    noise = Noise(np.maximum(sigma, shown.torque), np.maximum(shown.encoder, 1e-7), np.maximum(shown.gyro, 1e-6),
                  np.maximum(shown.accel, 1e-5), options.accel_correlation, joint_correlation(mechanism, options))
    return State(_latents(problem, motions), beta, noise.with_declared(options.noise, mechanism.actuated), covariance)


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
                 free: BoolArray, beta: FloatArray) -> State:
    """Start from slow motion alone, with noise levels at its residuals, for a model that is far wrong.

    Model error is smallest in slow motion. The usual start ends at beta = 0 there. (Measured on a gear that twists by
    0.3 rad/(N m): beta1 is 0.016 from the usual start, 0.173 from this one, true 0.181.)
    """
    slow = replace(options, cutoff_hz=GENTLE * options.cutoff(signals[0].rate_hz))
    state = start_state(problem, signals, mechanism, slow, free, beta)
    noise, still = state.noise, np.zeros((problem.total, problem.block))
    point = problem.linearise(state.x, state.beta, noise)
    left = problem.residuals_after(point, still, np.zeros(0), np.arange(0))
    levels = {kind: np.fmax(np.sqrt(np.mean(r**2, axis=-1 if kind == "gyro" else -2)), getattr(noise, kind))
              for kind, r in left.items() if kind != "e"}  # inf stays where nothing is read
    state.noise = replace(noise, **levels)
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
