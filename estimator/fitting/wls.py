"""Weighted least squares on filtered central differences, section III of the paper.

The weight is the inverse of the torque covariance; (29) prints the covariance itself.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from daq import BoolArray, Dataset, FloatArray
from estimator.errors import FitError
from estimator.fitting.identifiability import undetermined
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.result import FitResult, Trajectory
from estimator.signals import (
    Kinematics,
    SignalSet,
    angle_column,
    differentiate,
    lowpass,
    paper_differences,
    predicted_columns,
    split_signals,
)

ROWS = 256
"""Rows of a regressor that are factored at a time."""
WEIGHT_SHARE = 0.3
"""Least residual level of a joint as a share of the largest: a passive joint's equation is homogeneous in beta,
so weighting it by its own residual alone ends at beta = 0."""


def weighted_least_squares(z: FloatArray, tau: FloatArray, free: BoolArray, beta: FloatArray,
                           samples_per_dof: float, known_sigma: FloatArray | None = None
                           ) -> tuple[FloatArray, FloatArray, FloatArray]:
    """beta (p,), covariance (p, p), sigma (joints,) from z (m, n, p) and tau (m, n), eq. (28).

    Joints are weighted by `known_sigma` (n,), or by their own residual's variance, found in three passes. Entries of
    `beta` where `free` is False are kept. `samples_per_dof` is how many samples carry one independent value.
    """
    n = z.shape[1]
    beta = beta.copy()
    known = z[:, :, ~free] @ beta[~free]
    sigma = np.ones(n) if known_sigma is None else known_sigma
    covariance = np.zeros((beta.size, beta.size))
    if not free.any():
        return beta, covariance, np.maximum(np.std(tau - known, axis=0), 1e-9 * (1.0 + np.max(np.abs(tau))))
    floor, samples = 1e-9 * (1.0 + float(np.max(np.abs(tau)))), len(tau)
    rows, right = _triangles(z[:, :, free], tau - known)
    for _ in range(3 if known_sigma is None else 1):
        a = (rows / sigma[:, None, None]).reshape(-1, rows.shape[2])
        y = (right / sigma[:, None]).ravel()
        scale = np.linalg.norm(a, axis=0)
        scale[scale == 0.0] = 1.0
        u, s, vt = np.linalg.svd(a / scale, full_matrices=False)
        keep = s > 1e-12 * s[0]
        inverse = (vt[keep].T / s[keep]) @ u[:, keep].T
        beta[free] = (inverse @ y) / scale
        if known_sigma is None:
            sigma = np.maximum(np.sqrt(np.sum((right - rows @ beta[free]) ** 2, axis=1) / samples), floor)
            sigma = np.maximum(sigma, WEIGHT_SHARE * np.max(sigma))
        spread = (vt[keep].T / s[keep] ** 2) @ vt[keep] / np.outer(scale, scale)
        covariance[np.ix_(free, free)] = samples_per_dof * spread
    return beta, covariance, sigma


def _triangles(z: FloatArray, tau: FloatArray) -> tuple[FloatArray, FloatArray]:
    """z (m, n, p) and tau (m, n) as n joints' (n, r, p) and (n, r) with the same sums of squares, r <= p + 1."""
    small: FloatArray = np.concatenate([z, tau[:, :, None]], axis=2).swapaxes(0, 1)
    n, _, width = small.shape
    # piece by piece: a tall matrix is factored on several threads, which wait for each other on a busy machine
    # (measured: 20 ms instead of 1 for 5,000 rows)
    while small.shape[1] > max(ROWS, 2 * width):
        pieces = -(-small.shape[1] // ROWS)
        whole = np.zeros((n, pieces * ROWS, width))
        whole[:, : small.shape[1]] = small
        small = np.asarray(np.linalg.qr(whole.reshape(n, pieces, ROWS, width), mode="r")).reshape(n, -1, width)
    small = np.asarray(np.linalg.qr(small, mode="r"))
    return small[:, :, :-1], small[:, :, -1]


def driven_first(z: FloatArray, tau: FloatArray, free: BoolArray, beta: FloatArray,
                 mechanism: Mechanism) -> FloatArray:
    """beta (p,) from the equations of the driven joints alone, then the rest of it from those of the passive ones.

    A passive joint's equation is homogeneous: an error in the motion biases its least squares to beta = 0. Here it
    only adds the parameters that no driven joint's equation has, on the scale of the others.
    """
    driven, passive = list(mechanism.actuated), list(mechanism.passive)
    felt = free & (np.abs(z[:, driven]).max(axis=(0, 1)) > 0.0)
    first, _, _ = weighted_least_squares(z[:, driven], tau[:, driven], felt, beta, 1.0)
    second, _, _ = weighted_least_squares(z[:, passive], tau[:, passive], free & ~felt, first, 1.0)
    return second


def stack_regressors(signals: Sequence[SignalSet], motions: Sequence[Kinematics], mechanism: Mechanism,
                     cutoff_hz: float | None, order: int) -> tuple[FloatArray, FloatArray]:
    """Z (m, n, p) and torque (m, n) of all segments, both through the same low pass.

    The common filter keeps tau = Z beta true for the filtered values: torque carries the steps of Coulomb
    friction that the filtered angles cannot show.
    """
    z = stacked([mechanism.regressor(k.q, k.qd, k.qdd) for k in motions], signals[0].rate_hz, cutoff_hz, order)
    return z, stacked([s.torque for s in signals], signals[0].rate_hz, cutoff_hz, order)


def stacked(values: Sequence[FloatArray], rate_hz: float, cutoff_hz: float | None, order: int) -> FloatArray:
    """(m, ...) values (N, ...) of segments through the low pass, without its ends."""
    found = []
    for x in values:
        edge = min(len(x) // 10, int(0.5 * rate_hz / (cutoff_hz or rate_hz)))
        found.append(lowpass(x, cutoff_hz, rate_hz, order)[edge : len(x) - edge])
    return np.concatenate(found)


def free_mask(mechanism: Mechanism, options: FitOptions) -> tuple[BoolArray, FloatArray]:
    """(p,) mask of the estimated parameters, and beta with the fixed values. Raises `FitError` on a wrong name."""
    beta = np.zeros(mechanism.p)
    free = np.ones(mechanism.p, bool)
    for name, value in options.fixed.items():
        if name not in mechanism.names:
            raise FitError(f"{name} is no parameter of {mechanism.name}; it has {', '.join(mechanism.names)}")
        beta[mechanism.column(name)] = value
        free[mechanism.column(name)] = False
    return free, beta


class Design(NamedTuple):
    """The equations that least squares solves, and how they were made."""

    motions: list[Kinematics]
    z: FloatArray
    """(m, n, p)"""
    torque: FloatArray
    """(m, n)"""
    samples_per_dof: float
    """Samples that carry one independent value."""
    filtering: str


def around_samples(torque: FloatArray, hold: str) -> FloatArray:
    """Mean torque around each sample of torque (N, n), as a symmetric difference sees it.

    Held torque acts half a sample late on average. Without this, differences of a noise-free walker step leave a
    free-run error of 45 rad^2 instead of 1.2, which is the figure of the paper's Table III.
    """
    if hold != "zero":
        return torque
    out = torque.copy()
    out[1:] = 0.5 * (torque[1:] + torque[:-1])
    return out


def filtered_torque(s: SignalSet, options: FitOptions) -> FloatArray:
    """(34): torque (N, n) through the low pass, which with the recipe of section V is none unless it is given."""
    if options.half_power is None:
        return lowpass(s.torque, options.cutoff(s.rate_hz), s.rate_hz, options.filter_order)
    share = options.torque_half_power
    return s.torque if share is None else lowpass(s.torque, 0.5 * share * s.rate_hz, s.rate_hz, options.filter_order)


def design_rows(signals: Sequence[SignalSet], mechanism: Mechanism, options: FitOptions) -> Design:
    """Z and torque from filtered, differenced measurements, by the way that `options` names."""
    rate = signals[0].rate_hz
    if options.half_power is not None:
        motions = [paper_differences(s, mechanism, options) for s in signals]
        edge = 2 * options.spacing  # (61) needs that many samples on both sides
        z = [mechanism.regressor(*k)[edge : len(k.q) - edge] for k in motions]
        tau = [around_samples(filtered_torque(s, options), options.hold)[edge : len(s.torque) - edge] for s in signals]
        if min(len(part) for part in z) < mechanism.p:
            raise FitError(f"differences over {options.spacing} samples leave too little of {signals[0].run}")
        return Design(motions, np.concatenate(z), np.concatenate(tau), 1.0,
                      f"noisy angles low-passed at {options.half_power:g} of the Nyquist rate, differences over "
                      f"{options.spacing} samples")
    cutoff = options.cutoff(rate)
    first = min(4.0 * cutoff, 0.4 * rate)
    motions = [differentiate(s, mechanism, first, options.filter_order) for s in signals]
    return Design(motions, *stack_regressors(signals, motions, mechanism, cutoff, options.filter_order),
                  max(1.0, 0.5 * rate / cutoff),
                  f"angles low-passed at {first:g} Hz, both sides of the equation at {cutoff:g} Hz")


def fit_wls(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> FitResult:
    """Identify by (28) from low-passed, differenced measurements; see `FitOptions.cutoff_hz`.

    Errors in the angles bias this estimate towards zero: use `mle` for intervals.
    """
    start = time.perf_counter()
    signals = split_signals(datasets, mechanism, options)
    design = design_rows(signals, mechanism, options)
    motions, z, tau = design.motions, design.z, design.torque
    free, beta = free_mask(mechanism, options)
    weights = known_weights(mechanism, options)
    beta, covariance, sigma = weighted_least_squares(z, tau, free, beta, design.samples_per_dof, weights)
    trajectories = tuple(trajectory(s, k, mechanism, beta) for s, k in zip(signals, motions))
    return FitResult(
        mechanism, "wls", options.sensors, beta, covariance,
        {"torque_nm": float(np.max(sigma[list(mechanism.actuated)], initial=0.0))}, sigma, True, 1,
        sum(len(s.time_s) for s in signals), time.perf_counter() - start,
        undetermined(mechanism, beta, covariance, free),
        (design.filtering,
         "the filtered motion is taken as exact: errors in it bias the estimate and are not in the intervals",
         "torque errors are white within the filter's band"),
        (), trajectories, dict(options.fixed), options.hold)


def known_weights(mechanism: Mechanism, options: FitOptions) -> FloatArray | None:
    """(n,) standard deviations of Sigma_tau that `options` declares for (29); None where they are to be estimated."""
    if options.weights != "known":
        return None
    return np.array([options.torque_noise(j, j in mechanism.actuated) for j in range(mechanism.n)], dtype=np.float64)


def trajectory(s: SignalSet, k: Kinematics, mechanism: Mechanism, beta: FloatArray) -> Trajectory:
    measured = dict(s.imu)
    predicted: dict[str, FloatArray] = {}
    for j in range(mechanism.n):
        if np.isfinite(s.angles[:, j]).all():
            measured[angle_column(mechanism, j)] = s.angles[:, j]
            predicted[angle_column(mechanism, j)] = k.q[:, j]
    if s.imu:
        predicted |= predicted_columns(mechanism, k.q, k.qd, k.qdd)
    return Trajectory(s.run, s.time_s, k.q, k.qd, k.qdd, mechanism.inverse_dynamics(k.q, k.qd, k.qdd, beta),
                      s.torque, measured, predicted)
