"""Hybrid extended Kalman filter on states and parameters, appendix B of the paper, eqs. (68)-(74).

Correction of the paper: (71) must read dP/dt = A P + P A^T + L Q L^T. A and L are evaluated at the estimate after the
last measurement and kept until the next. Q is the density sigma_u^2 T_s of the torque's measurement noise; parameters
have no process noise. R records are filtered at once.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq import BoolArray, Dataset, FloatArray
from estimator.errors import FitError
from estimator.fitting.identifiability import undetermined
from estimator.fitting.noise_levels import first_levels
from estimator.fitting.wls import design_rows, free_mask, trajectory, weighted_least_squares
from estimator.model import Collocation, Mechanism, Motion
from estimator.options import FitOptions
from estimator.result import FitResult
from estimator.signals import (
    IMU_COLUMNS,
    Kinematics,
    SignalSet,
    accelerometer,
    encoder_level,
    split_signals,
)

SUBSTEPS = 4
"""Runge-Kutta steps between two samples."""
EXACT_RAD = 1e-5
"""Standard deviation of an encoder without noise [rad]; with less, P is not positive definite in double precision."""
RATE_SPREAD = 0.5
"""First standard deviation of the rates [rad/s]: differences of a filtered record are wrong at its ends."""
BETA_SPREAD = 0.3
"""First standard deviation of a parameter, as a share of its first estimate."""
RATE_LIMIT = 1e4
"""A rate beyond this [rad/s] ends a filter: it has failed to integrate."""


@dataclass
class Filtered:
    """R filters after their last sample."""

    x: FloatArray
    """(R, 2 n + p) angles, rates, beta"""
    covariance: FloatArray
    """(R, 2 n + p, 2 n + p)"""
    lost: BoolArray
    """(R,) failed to integrate on the way"""


@dataclass(frozen=True)
class Filter:
    """The augmented model (69), (70) of one mechanism and sensor path, for R records at once."""

    mechanism: Mechanism
    free: BoolArray
    """(p,) parameters that are estimated"""
    dt_s: float
    hold: str
    torque_variance: FloatArray
    """(n,) [N^2 m^2], zero on a passive joint"""
    variance: FloatArray
    """(y,) of the measurements: encoders in use, then gyro, a_x, a_y on the IMU path"""
    encoders: tuple[int, ...]
    imu: bool

    def run(self, y: FloatArray, torque: FloatArray, x: FloatArray, covariance: FloatArray) -> Filtered:
        """Filter y (R, N, y) driven by torque (R, N, n) from x (R, 2 n + p) and its covariance."""
        state = Filtered(x.copy(), covariance.copy(), np.zeros(len(x), bool))
        for k in range(y.shape[1]):
            if k:
                self._predict(state, torque[:, k - 1], torque[:, k])
            self._correct(state, y[:, k], torque[:, k])
            if state.lost.all():
                break
        return state

    def acceleration(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """qdd (R, n) of states x (R, 2 n + p) under torque u (R, n)."""
        n = self.mechanism.n
        return self.mechanism.forward_dynamics(x[:, :n], x[:, n : 2 * n], u, x[:, 2 * n :])

    def slopes(self, x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """d(qdd)/dx (R, n, 2 n + p) and d(qdd)/du = D^-1 (R, n, n), by implicit differentiation of (13)."""
        m = self.mechanism
        n = m.n
        q, v, beta = x[:, :n], x[:, n : 2 * n], x[:, 2 * n :]
        qdd = self.acceleration(x, u)
        c = Collocation(m, self.dt_s, self.hold)
        z, found = c.terms(Motion(*(a.T[:, None] for a in (q, v, qdd, v, v))))
        own = c.feature_slopes(found, beta.T, (1, len(x)))[:, :, :, 0].transpose(3, 0, 1, 2)  # (R, n, 5, n)
        inverse = np.asarray(np.linalg.inv(own[:, :, 2]), dtype=np.float64)
        columns = c.to_joint(z)[:, :, 0].transpose(2, 1, 0) * self.free
        right = np.concatenate([own[:, :, 0], own[:, :, 1] + own[:, :, 3] + own[:, :, 4], columns], axis=-1)
        return -inverse @ right, inverse

    def _predict(self, state: Filtered, before: FloatArray, after: FloatArray) -> None:
        n, size = self.mechanism.n, state.x.shape[1]
        x, alive = np.where(state.lost[:, None], self._harmless(state.x), state.x), ~state.lost
        slope, inverse = self.slopes(x, before)
        a = np.zeros((len(x), size, size))
        a[:, :n, n : 2 * n] = np.eye(n)
        a[:, n : 2 * n] = slope
        noise = np.zeros_like(a)
        noise[:, n : 2 * n, n : 2 * n] = (inverse * (self.torque_variance * self.dt_s)) @ inverse.swapaxes(1, 2)
        h = self.dt_s / SUBSTEPS
        p = state.covariance
        with np.errstate(over="ignore", invalid="ignore"):
            for i in range(SUBSTEPS):
                x = self._advance(x, before, after, i, h)
                p = _advance_covariance(a, noise, p, h)
        fine = np.isfinite(x).all(axis=1) & np.isfinite(p).all(axis=(1, 2)) & (
            np.abs(x[:, n : 2 * n]) < RATE_LIMIT).all(axis=1)
        good = alive & fine
        state.x[good], state.covariance[good] = x[good], p[good]
        state.lost |= alive & ~fine

    def _advance(self, x: FloatArray, before: FloatArray, after: FloatArray, i: int, h: float) -> FloatArray:
        n = self.mechanism.n

        def torque(share: float) -> FloatArray:
            if self.hold == "zero":
                return before
            if self.hold == "average":
                return before if share < 0.5 else after
            return (1.0 - share) * before + share * after

        def rate(at: FloatArray, share: float) -> FloatArray:
            out = np.zeros_like(at)
            out[:, :n], out[:, n : 2 * n] = at[:, n : 2 * n], self.acceleration(at, torque(share))
            return out

        first, middle, last = (i + s for s in (0.0, 0.5, 1.0 - 1e-9))
        k1 = rate(x, first / SUBSTEPS)
        k2 = rate(x + 0.5 * h * k1, middle / SUBSTEPS)
        k3 = rate(x + 0.5 * h * k2, middle / SUBSTEPS)
        k4 = rate(x + h * k3, last / SUBSTEPS)
        return x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)

    def _harmless(self, x: FloatArray) -> FloatArray:
        """A state that can be integrated, in place of those that are lost; its results are not used."""
        out = np.zeros_like(x)
        inertia = [2 * self.mechanism.n + k for k, a in enumerate(self.mechanism.parameters)
                   if a.term == "inertia" and a.at[0] == a.at[1]]
        out[:, inertia] = 1.0
        return out

    def _correct(self, state: Filtered, y: FloatArray, u: FloatArray) -> None:
        """(72)-(74) at one sample."""
        x = np.where(state.lost[:, None], self._harmless(state.x), state.x)
        predicted, h = self._measurement(x, u)
        p = state.covariance
        spread = h @ p @ h.swapaxes(1, 2) + np.diag(self.variance)
        with np.errstate(over="ignore", invalid="ignore"):
            gain = p @ h.swapaxes(1, 2) @ np.linalg.pinv(spread, hermitian=True)
            moved = x + (gain @ (y - predicted)[..., None])[..., 0]
            keep = np.eye(x.shape[1]) - gain @ h
            joseph = keep @ p @ keep.swapaxes(1, 2) + (gain * self.variance) @ gain.swapaxes(1, 2)
        fine = np.isfinite(moved).all(axis=1) & np.isfinite(joseph).all(axis=(1, 2))
        good = fine & ~state.lost
        state.x[good] = moved[good]
        state.covariance[good] = 0.5 * (joseph[good] + joseph[good].swapaxes(1, 2))
        state.lost |= ~fine

    def _measurement(self, x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """h(x) (R, y) and H (R, y, 2 n + p) of (70)."""
        n, m = self.mechanism.n, self.mechanism
        count = len(self.encoders)
        value = np.zeros((len(x), self.variance.size))
        slope = np.zeros((len(x), self.variance.size, x.shape[1]))
        for row, joint in enumerate(self.encoders):
            value[:, row], slope[:, row, joint] = x[:, joint], 1.0
        if self.imu:
            q1, v1 = x[:, 0], x[:, n]
            ax, ay = accelerometer(q1, v1, self.acceleration(x, u)[:, 0], m.lever_arm, m.gravity_mps2)
            value[:, count:] = np.stack([v1, ax, ay], axis=-1)
            slope[:, count, n] = 1.0
            slope[:, count + 1] = m.lever_arm * self.slopes(x, u)[0][:, 0]
            slope[:, count + 1, 0] += m.gravity_mps2 * np.cos(q1)
            slope[:, count + 2, 0] = m.gravity_mps2 * np.sin(q1)
            slope[:, count + 2, n] = -2.0 * m.lever_arm * v1
        return value, slope


def _advance_covariance(a: FloatArray, noise: FloatArray, p: FloatArray, h: float) -> FloatArray:
    """One Runge-Kutta step of (71), with the transpose."""
    def rate(at: FloatArray) -> FloatArray:
        flow = a @ at
        return flow + flow.swapaxes(1, 2) + noise

    k1 = rate(p)
    k2 = rate(p + 0.5 * h * k1)
    k3 = rate(p + 0.5 * h * k2)
    k4 = rate(p + h * k3)
    return p + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


@dataclass(frozen=True)
class Start:
    """Start of a filter: WLS-FCD of the same record."""

    motion: Kinematics
    beta: FloatArray
    sigma: FloatArray


def first_estimate(signals: SignalSet, mechanism: Mechanism, options: FitOptions, free: BoolArray,
                   beta: FloatArray) -> Start:
    """WLS-FCD on one segment."""
    design = design_rows([signals], mechanism, options)
    beta, _, sigma = weighted_least_squares(design.z, design.torque, free, beta, 1.0)
    return Start(design.motions[0], beta, sigma)


def build_filter(signals: SignalSet, mechanism: Mechanism, options: FitOptions, free: BoolArray,
                 sigma: FloatArray) -> Filter:
    """Noise as declared in `options`, otherwise as the segment shows it; `sigma` (n,) torque residuals."""
    imu = bool(signals.imu)
    encoders = tuple(j for j in range(mechanism.n) if np.isfinite(signals.angles[:, j]).all())
    levels = []
    for j in encoders:
        given = options.encoder_noise(j)
        levels.append(max(encoder_level(signals.angles[:, j]) if given is None else given, EXACT_RAD))
    if imu:
        levels += first_levels(options, [signals.imu[name] for name in IMU_COLUMNS]).tolist()
    torque = np.zeros(mechanism.n)
    for j in mechanism.actuated:
        known = options.torque_noise(j, True)
        torque[j] = sigma[j] ** 2 if known is None else known**2
    return Filter(mechanism, free, 1.0 / signals.rate_hz, options.hold, torque, np.square(levels), encoders, imu)


def measurements(signals: SignalSet, encoders: tuple[int, ...]) -> FloatArray:
    """(N, y) in the order of `Filter.variance`."""
    columns = [signals.angles[:, j] for j in encoders]
    columns += [signals.imu[name] for name in IMU_COLUMNS] if signals.imu else []
    return np.stack(columns, axis=-1)


def first_state(start: Start, filter_: Filter) -> tuple[FloatArray, FloatArray]:
    """x (2 n + p,) and P of the first sample."""
    n, p = filter_.mechanism.n, filter_.mechanism.p
    x = np.concatenate([start.motion.q[0], start.motion.qd[0], start.beta])
    size = np.maximum(np.abs(start.beta), 1e-3 * np.max(np.abs(start.beta), initial=1e-9))
    angle = np.full(n, 0.1)
    for row, joint in enumerate(filter_.encoders):
        angle[joint] = 3.0 * np.sqrt(filter_.variance[row])
    spread = np.concatenate([angle, np.full(n, RATE_SPREAD), BETA_SPREAD * size * filter_.free])
    assert spread.size == 2 * n + p
    return x, np.diag(spread**2)


def fit_hekf(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> FitResult:
    """Identify by (68)-(74) on one segment after the other; the parameters and their covariance are handed on.

    Raises `FitError` where the filter fails to integrate, as the paper reports of it.
    """
    begun = time.perf_counter()
    signals = split_signals(datasets, mechanism, options)
    free, given = free_mask(mechanism, options)
    n = mechanism.n
    handed: tuple[FloatArray, FloatArray] | None = None
    for s in signals:
        start = first_estimate(s, mechanism, options, free, given)
        filter_ = build_filter(s, mechanism, options, free, start.sigma)
        x, p = first_state(start, filter_)
        if handed is not None:
            x[2 * n :], p[2 * n :, 2 * n :] = handed
        done = filter_.run(measurements(s, filter_.encoders)[None], s.torque[None], x[None], p[None])
        if done.lost[0]:
            raise FitError(f"the filter failed to integrate on {s.run}; use mle")
        handed = done.x[0, 2 * n :], done.covariance[0, 2 * n :, 2 * n :]
    assert handed is not None
    return hekf_result(signals, mechanism, options, free, *handed, time.perf_counter() - begun)


def hekf_result(signals: Sequence[SignalSet], mechanism: Mechanism, options: FitOptions, free: BoolArray,
                beta: FloatArray, covariance: FloatArray, wall_s: float) -> FitResult:
    """The filter's last estimate as a `FitResult`, with the torque residual of the differenced motion."""
    design = design_rows(signals, mechanism, options)
    residual = design.torque - design.z @ beta
    return FitResult(
        mechanism, "hekf", options.sensors, beta, covariance, dict(options.noise),
        np.sqrt(np.mean(residual**2, axis=0)), True, 1, sum(len(s.time_s) for s in signals), wall_s,
        undetermined(mechanism, beta, covariance, free),
        (f"torque acts between samples by the '{options.hold}' hold",
         "the filter's linearisation holds over a sample; its intervals mean little where it does not",
         "the first estimate (wls) is wrong by 30 % at 1 sigma"),
        (), tuple(trajectory(s, k, mechanism, beta) for s, k in zip(signals, design.motions)), dict(options.fixed),
        options.hold)
