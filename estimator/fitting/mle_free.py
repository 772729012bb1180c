"""Maximum likelihood with the paper's free latents, section IV: `mle` with `latent = "free"`.

Unknown at every sample, and nothing ties them together but central differences: on the IMU path sin(q1), cos(q1)
and q1d, with q1dd differenced from q1d by (43); on the encoder path q1 itself, with q1d by (42) and q1dd by (43).
Everything else is taken as measured, filtered and differenced, (34)-(39). beta is eliminated at every step by
(45), the sum of squares (50) is lowered by Gauss-Newton on all of them with exact, sparse derivatives: the
residual of a sample depends on its neighbours only, so a step costs a time that grows linearly with samples.
The paper's numerical gradient and Hessian give the same minimum (tests/estimator/fitting/test_mle_free.py), at a cost
that grows with the square of the samples for the gradient alone.

Corrections of the paper: the signs of (63) (`estimator.signals.imu.tilt`); (29) has the inverse covariance; the step
(51) is -H^-1 g. As in the paper sin and cos are independent unknowns.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from daq import BoolArray, Dataset, FloatArray, IndexArray
from estimator.errors import FitError
from estimator.fitting.identifiability import undetermined
from estimator.fitting.noise_levels import first_levels
from estimator.fitting.rls import torque_variance
from estimator.fitting.wls import around_samples, design_rows, filtered_torque, free_mask, weighted_least_squares
from estimator.model import ACCEL, ANGLE, RATE, RATE_FROM, RATE_TO, Collocation, Mechanism, Motion
from estimator.numerics import pseudo_inverse
from estimator.options import FitOptions
from estimator.result import FitResult, Trajectory
from estimator.signals import (
    IMU_COLUMNS,
    SignalSet,
    accelerometer,
    angle_column,
    split_signals,
    tilt,
    white_noise_level,
)

MAX_STEPS = 100
"""Most steps of the search."""
TOLERANCE = 1e-10
"""The search ends when a step lowers the sum of squares by less than this share."""


def difference_matrix(samples: int, dt_s: float) -> sparse.csr_array:
    """(N, N) of (42) and (43); the first and last row are empty, because they have no neighbour on one side."""
    half = 0.5 / dt_s
    matrix = sparse.diags_array([-half, half], offsets=[-1, 1], shape=(samples, samples)).tolil()
    matrix[0, :], matrix[-1, :] = 0.0, 0.0
    return sparse.csr_array(matrix)


@dataclass(frozen=True)
class FreeProblem:
    """The sum of squares (50) of one fit. Latents w: (s, c, v) laid one after the other on the IMU path, else q1."""

    mechanism: Mechanism
    imu: bool
    q: FloatArray
    """(N, n) filtered angles; column 0 is not used"""
    qd: FloatArray
    qdd: FloatArray
    torque: FloatArray
    """(N, n)"""
    measured: FloatArray
    """(latents,) what the sensors say of each latent"""
    sigma: FloatArray
    """(latents,)"""
    torque_sigma: FloatArray
    """(n,)"""
    difference: sparse.csr_array
    """(N, N)"""
    inner: IndexArray
    """samples whose differences exist"""
    free: BoolArray
    """(p,) parameters that are estimated"""
    given: FloatArray
    """(p,) the values of the others"""

    def motion(self, w: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """sin(q1), cos(q1), q1d, q1dd (N,) that the latents stand for."""
        if self.imu:
            s, c, v = np.split(w, 3)
            return s, c, v, self.difference @ v
        v = self.difference @ w
        return np.sin(w), np.cos(w), v, self.difference @ v

    def regressor(self, w: FloatArray) -> FloatArray:
        """Z~ (m, n, p) of (44) at the inner samples."""
        s, c, v, a = (x[self.inner] for x in self.motion(w))
        q, qd, qdd = (x[self.inner].copy() for x in (self.q, self.qd, self.qdd))
        q[:, 0], qd[:, 0], qdd[:, 0] = 0.0, v, a
        still = np.zeros_like(q)
        level = self.mechanism.regressor(q, still, still) * self._gravity
        q[:, 0] = 0.5 * np.pi
        by_gravity = self.mechanism.regressor(q, still, still) * self._gravity
        z = self.mechanism.regressor(q, qd, qdd) - by_gravity
        return z + s[:, None, None] * by_gravity + c[:, None, None] * level

    @property
    def _gravity(self) -> FloatArray:
        return np.array([float(a.term == "gravity") for a in self.mechanism.parameters])

    def best_beta(self, z: FloatArray) -> FloatArray:
        """(45) for Z~ (m, n, p)."""
        u = self.torque[self.inner] - z[:, :, ~self.free] @ self.given[~self.free]
        a = (z[:, :, self.free] / self.torque_sigma[:, None]).reshape(-1, int(self.free.sum()))
        scale = np.linalg.norm(a, axis=0)
        scale[scale == 0.0] = 1.0
        beta = self.given.copy()
        beta[self.free] = np.linalg.lstsq(a / scale, (u / self.torque_sigma).ravel(), rcond=None)[0] / scale
        return beta

    def residual(self, w: FloatArray, beta: FloatArray | None = None) -> FloatArray:
        """Weighted residuals (47)-(49): torques of the inner samples, then the latents'. beta None: its best value."""
        z = self.regressor(w)
        beta = self.best_beta(z) if beta is None else beta
        torque = (self.torque[self.inner] - z @ beta) / self.torque_sigma
        return np.concatenate([torque.ravel(), (self.measured - w) / self.sigma])

    def jacobian(self, w: FloatArray, beta: FloatArray) -> tuple[sparse.csr_array, FloatArray]:
        """Jacobian of `residual` by the latents, sparse, and by the free parameters (m n, free)."""
        s, c, v, a = self.motion(w)
        q, qd, qdd = (x[self.inner].copy() for x in (self.q, self.qd, self.qdd))
        q[:, 0] = np.arctan2(s, c)[self.inner]
        qd[:, 0], qdd[:, 0] = v[self.inner], a[self.inner]
        collocation = Collocation(self.mechanism, 1.0, "zero")
        _, slopes = collocation.terms(Motion(*(x.T[:, None] for x in (q, qd, qdd, qd, qd))))
        own = collocation.feature_slopes(slopes, beta, (1, self.inner.size))[:, :, 0, 0]  # (n, 5, m)
        by_rate, by_accel = own[:, RATE] + own[:, RATE_FROM] + own[:, RATE_TO], own[:, ACCEL]
        count, n = self.inner.size, self.mechanism.n
        pick = sparse.csr_array((np.ones(count), (np.arange(count), self.inner)), shape=(count, len(s)))
        first, second = pick @ self.difference, pick @ self.difference @ self.difference
        rows = []
        if self.imu:
            still = np.zeros_like(q)
            q[:, 0] = 0.0
            level = (self.mechanism.regressor(q, still, still) * self._gravity) @ beta
            q[:, 0] = 0.5 * np.pi
            by_gravity = (self.mechanism.regressor(q, still, still) * self._gravity) @ beta
            for i in range(n):
                by_speed = sparse.diags_array(by_rate[i]) @ pick + sparse.diags_array(by_accel[i]) @ first
                rows.append(sparse.hstack([sparse.diags_array(by_gravity[:, i]) @ pick,
                                           sparse.diags_array(level[:, i]) @ pick, by_speed]))
        else:
            for i in range(n):
                rows.append(sparse.diags_array(own[i, ANGLE]) @ pick + sparse.diags_array(by_rate[i]) @ first
                            + sparse.diags_array(by_accel[i]) @ second)
        scaled = [-row / sigma for row, sigma in zip(rows, self.torque_sigma)]
        order = np.arange(n * count).reshape(n, count).T.ravel()  # sample by sample, as `residual` has them
        top = sparse.csr_array(sparse.vstack(scaled))[order]
        latents = sparse.csr_array(sparse.vstack([top, -sparse.diags_array(1.0 / self.sigma)]))
        z = -(self.regressor(w)[:, :, self.free] / self.torque_sigma[:, None]).reshape(n * count, -1)
        return latents, z


@dataclass(frozen=True)
class Minimum:
    """Minimum of the sum of squares."""

    w: FloatArray
    beta: FloatArray
    covariance: FloatArray
    """(free, free) of the free parameters, by the Gauss-Newton information"""
    objective: float
    steps: int
    converged: bool


def minimise(problem: FreeProblem, w: FloatArray) -> Minimum:
    """Damped Gauss-Newton on all latents from w, beta at its best value throughout."""
    damping = 0.0
    z = problem.regressor(w)
    beta = problem.best_beta(z)
    r = problem.residual(w, beta)
    objective, converged, steps = float(r @ r), False, 0
    while steps < MAX_STEPS and not converged:
        latents, by_beta = problem.jacobian(w, beta)
        gradient = latents.T @ r
        information = sparse.csc_array(latents.T @ latents)
        border = latents[: len(by_beta)].T @ by_beta
        corner, score = by_beta.T @ by_beta, by_beta.T @ r[: len(by_beta)]
        while steps < MAX_STEPS:
            steps += 1
            damped = information + damping * sparse.diags_array(information.diagonal())
            solver = splu(sparse.csc_array(damped), permc_spec="COLAMD")
            eliminated = solver.solve(np.column_stack([gradient, border]))
            schur = corner - border.T @ eliminated[:, 1:]
            step_beta = -pseudo_inverse(schur) @ (score - border.T @ eliminated[:, 0])
            moved = w - eliminated[:, 0] - eliminated[:, 1:] @ step_beta
            new_beta = problem.best_beta(problem.regressor(moved))
            new = problem.residual(moved, new_beta)
            lower = float(new @ new)
            if lower <= objective:
                break
            damping = max(4.0 * damping, 1e-4)
            if damping > 1e8:
                return Minimum(w, beta, pseudo_inverse(schur), objective, steps, True)
        converged = objective - lower <= TOLERANCE * objective
        w, beta, r, objective = moved, new_beta, new, lower
        damping = damping / 10.0 if damping > 1e-6 else 0.0
    return Minimum(w, beta, pseudo_inverse(schur), objective, steps, converged)


def build_problem(signals: Sequence[SignalSet], mechanism: Mechanism, options: FitOptions) -> FreeProblem:
    """Filtered data and noise levels: as declared, otherwise as differences and a first fit show them."""
    free, given = free_mask(mechanism, options)
    rate = signals[0].rate_hz
    design = design_rows(signals, mechanism, options)
    _, _, sigma = weighted_least_squares(design.z, design.torque, free, given.copy(), 1.0)
    sigma = np.sqrt(torque_variance(mechanism, sigma, options))
    imu = bool(signals[0].imu)
    lengths = [len(s.time_s) for s in signals]
    ends = np.cumsum(lengths)
    edge = 1 if imu else 2
    inner = np.concatenate([np.arange(e - n + edge, e - edge) for e, n in zip(ends, lengths)])
    difference = sparse.csr_array(sparse.block_diag([difference_matrix(n, 1.0 / rate) for n in lengths]))
    measured, level = _measured(signals, mechanism, options, imu)
    q, qd, qdd = (np.concatenate([k[i] for k in design.motions]) for i in range(3))
    torque = np.concatenate([around_samples(filtered_torque(s, options), options.hold) for s in signals])
    return FreeProblem(mechanism, imu, q, qd, qdd, torque, measured, level, np.maximum(sigma, 1e-12), difference,
                       inner, free, given)


def _measured(signals: Sequence[SignalSet], mechanism: Mechanism, options: FitOptions,
              imu: bool) -> tuple[FloatArray, FloatArray]:
    """y_h and y_q1d of (21), (22), not filtered, and their standard deviations, both (latents,)."""
    if not imu:
        angle = np.concatenate([s.angles[:, 0] for s in signals])
        given = options.encoder_noise(0)
        level = white_noise_level(angle) if given is None else given
        return angle, np.full(angle.size, max(level, 1e-9))
    parts: list[FloatArray] = []
    for s in signals:
        gyro, ax, ay = (s.imu[name] for name in IMU_COLUMNS)
        rate = options.cutoff(s.rate_hz)
        _, _, q1dd = tilt(ax, ay, gyro, s.rate_hz, mechanism.lever_arm, rate, options.filter_order)
        g = mechanism.gravity_mps2
        parts.append(np.stack([(ax - mechanism.lever_arm * q1dd) / g,
                               (-ay - mechanism.lever_arm * gyro**2) / g, gyro]))
    joined = np.concatenate(parts, axis=1)
    raw = [np.concatenate([s.imu[name] for s in signals]) for name in IMU_COLUMNS]
    gyro_level, *accel = first_levels(options, raw)
    return joined.ravel(), np.repeat([*(level / mechanism.gravity_mps2 for level in accel), gyro_level],
                                     joined.shape[1])


def first_latents(problem: FreeProblem) -> FloatArray:
    """(40), (41): the filtered measurements."""
    if problem.imu:
        return np.concatenate([np.sin(problem.q[:, 0]), np.cos(problem.q[:, 0]), problem.qd[:, 0]])
    return problem.q[:, 0].copy()


def fit_mle_free(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> FitResult:
    """Identify by (33) over free latents; see the module's text. Raises `FitError`."""
    start = time.perf_counter()
    signals = split_signals(datasets, mechanism, options)
    if not np.all(mechanism.transform[:, 0] == 1.0):
        raise FitError(f"free latents need every link of {mechanism.name} to turn with joint 1")
    problem = build_problem(signals, mechanism, options)
    found = minimise(problem, first_latents(problem))
    covariance = np.zeros((mechanism.p, mechanism.p))
    covariance[np.ix_(problem.free, problem.free)] = found.covariance
    paths, residual = _trajectories(problem, signals, found)
    noise = {"torque_nm": float(np.max(problem.torque_sigma[list(mechanism.actuated)], initial=0.0))}
    return FitResult(
        mechanism, "mle-free", options.sensors, found.beta, covariance, noise,
        np.sqrt(np.mean(residual**2, axis=0)), found.converged, found.steps, len(problem.torque),
        time.perf_counter() - start, undetermined(mechanism, found.beta, covariance, problem.free),
        ("derivatives are central differences of the latents; their bias is not in the intervals",
         "relative angles are exact after filtering", "noise is white, Gaussian and of the levels given or first seen"),
        (), paths, dict(options.fixed), options.hold)


def _trajectories(problem: FreeProblem, signals: Sequence[SignalSet],
                  minimum: Minimum) -> tuple[tuple[Trajectory, ...], FloatArray]:
    """Motion and sensor predictions by segment, and the torque residual (m, n)."""
    m = problem.mechanism
    s, c, v, a = problem.motion(minimum.w)
    q, qd, qdd = problem.q.copy(), problem.qd.copy(), problem.qdd.copy()
    q[:, 0], qd[:, 0], qdd[:, 0] = np.unwrap(np.arctan2(s, c)), v, a
    tau = m.inverse_dynamics(q, qd, qdd, minimum.beta)
    residual = problem.torque[problem.inner] - problem.regressor(minimum.w) @ minimum.beta
    paths, at = [], 0
    for signal in signals:
        part = slice(at, at + len(signal.time_s))
        at = part.stop
        measured: dict[str, FloatArray] = dict(signal.imu)
        predicted: dict[str, FloatArray] = {}
        for j in range(m.n):
            if np.isfinite(signal.angles[:, j]).all():
                measured[angle_column(m, j)], predicted[angle_column(m, j)] = signal.angles[:, j], q[part, j]
        if signal.imu:
            ax, ay = accelerometer(q[part, 0], qd[part, 0], qdd[part, 0], m.lever_arm, m.gravity_mps2)
            predicted |= {"gyro_radps": qd[part, 0], "accel_x_mps2": ax, "accel_y_mps2": ay}
        paths.append(Trajectory(signal.run, signal.time_s, q[part], qd[part], qdd[part], tau[part], signal.torque,
                                measured, predicted))
    return tuple(paths), residual
