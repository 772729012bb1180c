"""`LatentProblem`: the joint likelihood of one latent motion and the parameters, linearised.

Unknown at each sample: angle q, rate v and true torque u of every joint (block size b = 3 joints); common:
beta. Residuals, each over its standard deviation:

    equation of motion at two Gauss points an interval   Z(q, v) beta - hold(u)        sigma_u * TIGHT
    torque sample (zero on a passive joint)              u - y_u                       sigma_u
    encoder, gyro                                        q - y_q, v1 - y_g             sigma_q, sigma_g
    accelerometer                                        a(q1, v1, q1dd) - y_a         sigma_a

The passive joint's torque is exactly zero, so B Sigma_u B^T of (17) is singular; its sigma_u stands for what
the model gets wrong there. Normal equations are block tridiagonal in the latents with a dense border for
beta; cost grows linearly with samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimator.collocation import Collocation
from estimator.mechanism import Mechanism
from estimator.sensors import accelerometer
from estimator.signalset import IMU_COLUMNS, SignalSet

FloatArray = NDArray[np.float64]
TIGHT = 0.1
"""Standard deviation of the equation of motion at a Gauss point, as a share of the joint's torque noise: an
interval's two points then add half a per cent to the variance of its torque."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations in force."""

    torque: FloatArray
    """(n,) [N m]; on a passive joint what the model gets wrong."""
    encoder: FloatArray
    """(n,) [rad]; inf for a joint without an encoder."""
    gyro: float = np.inf
    accel: float = np.inf


@dataclass(frozen=True)
class Latents:
    """Values at all N samples, each (N, n)."""

    q: FloatArray
    v: FloatArray
    u: FloatArray

    def moved(self, step: FloatArray) -> Latents:
        """Shifted by step (N, 3 n) in the order q, v, u."""
        n = self.q.shape[1]
        return Latents(self.q + step[:, :n], self.v + step[:, n:2 * n], self.u + step[:, 2 * n:])


@dataclass(frozen=True)
class Extra:
    """What effects add to the model at one point, and its derivative by their k sizes."""

    torque: FloatArray
    """(n, 2, K) torque that the motion needs beyond Z beta, at the Gauss points [N m]."""
    torque_at_samples: FloatArray
    """(n, N)"""
    readings: Mapping[str, FloatArray]
    """Channel (torque1, encoder2, gyro, accel_x, accel_y, ...) to what is added to its reading, (N,)."""
    torque_columns: FloatArray
    """(k, n, 2, K)"""
    sample_columns: FloatArray
    """(k, n, N)"""
    reading_columns: Mapping[str, FloatArray]
    """Channel to (k, N)."""
    slopes: FloatArray | None = None
    """(n, 5, n, 2, K) derivative of `torque` by the features of the motion, where it is known."""
    sample_slopes: FloatArray | None = None
    """(n, 5, n, N)"""


@dataclass(frozen=True)
class Linearised:
    """Gauss-Newton normal equations at one point."""

    objective: float
    diagonal: FloatArray
    """(N, b, b)"""
    lower: FloatArray
    """(N-1, b, b)"""
    gradient: FloatArray
    """(N b,)"""
    border: FloatArray
    """(N b, p)"""
    corner: FloatArray
    """(p, p)"""
    gradient_beta: FloatArray
    """(p,)"""
    accel_rows: FloatArray
    """(N, 2, b) unscaled accelerometer rows, none without an IMU."""
    accel_border: FloatArray
    """(N, 2, p) their derivative by beta."""
    residuals: dict[str, FloatArray]
    """Unscaled residuals by channel."""
    extra: Extra | None = None


class LatentProblem:
    """All stretches of all runs on one stack of samples; see the module's text."""

    def __init__(self, signals: Sequence[SignalSet], mechanism: Mechanism, hold: str) -> None:
        self.mechanism = mechanism
        self.n = mechanism.n
        self.block = 3 * mechanism.n
        lengths = [len(s.time_s) for s in signals]
        self.ends = np.cumsum(lengths)
        self.total = int(self.ends[-1])
        self.left = np.setdiff1d(np.arange(self.total - 1), self.ends[:-1] - 1)
        """Samples that begin an interval."""
        self.dt = 1.0 / signals[0].rate_hz
        self.collocation = Collocation(mechanism, self.dt, hold)
        self.torque = np.concatenate([s.torque for s in signals])
        self.angles = np.concatenate([s.angles for s in signals])
        self.has_encoder = np.isfinite(self.angles).all(axis=0)
        self.has_imu = bool(signals[0].imu)
        if self.has_imu:
            self.gyro, self.ax, self.ay = (np.concatenate([s.imu[c] for s in signals]) for c in IMU_COLUMNS)

    def linearise(self, x: Latents, beta: FloatArray, noise: Noise, extra: Extra | None = None) -> Linearised:
        """Residuals, Gauss-Newton blocks and border at (x, beta); columns of `extra` follow those of beta."""
        b, left, c = self.block, self.left, self.collocation
        motion = c.motion(x.q, x.v, left)
        z_raw, slopes = c.terms(motion)
        z = c.to_joint(z_raw)  # (p, n, 2, K)
        defect = np.tensordot(beta, z, axes=1) - c.torque(x.u, left)  # (n, 2, K)
        if extra is not None:
            defect = defect + extra.torque
        # (n, 2, 4, n, K)
        jac = c.jacobian(slopes, beta, motion.angle.shape[1:], None if extra is None else extra.slopes)
        if extra is not None:
            z = np.concatenate([z, extra.torque_columns])
        residuals: dict[str, FloatArray] = {"defect": defect}
        equations = self._equations(jac, z, defect, 1.0 / (TIGHT * noise.torque))
        width = 2 * b + z.shape[0]
        local = equations[:, :, : 2 * b].swapaxes(1, 2) @ equations
        tall = equations[:, :, 2 * b :].reshape(-1, z.shape[0] + 1)
        square = tall.T @ tall
        corner, gradient_beta, objective = square[:-1, :-1], square[:-1, -1], float(square[-1, -1])

        diagonal = np.zeros((self.total, b, b))
        lower = np.zeros((self.total - 1, b, b))
        gradient = np.zeros((self.total, b))
        border = np.zeros((self.total, b, z.shape[0]))
        for here, first, last in self._spans:
            part = local[here]
            diagonal[first:last], diagonal[first + 1 : last + 1] = part[:, :b, :b], part[:, b:, b : 2 * b]
            diagonal[first + 1 : last] += part[1:, :b, :b]
            lower[first:last] = part[:, b:, :b]
            gradient[first:last] = part[:, :b, width]
            gradient[first + 1 : last + 1] += part[:, b:, width]
            border[first:last] = part[:, :b, 2 * b : width]
            border[first + 1 : last + 1] += part[:, b:, 2 * b : width]
        accel_rows, za = np.empty((0, 2, b)), np.empty((0, 2, z.shape[0]))
        if self.has_imu:
            accel_rows, ra, za = self._accelerometer(x, beta, extra)
            residuals["accel"] = ra
            rows = np.concatenate([accel_rows, za, ra[..., None]], axis=-1) / noise.accel
            local = rows[..., :b].swapaxes(1, 2) @ rows
            diagonal += local[..., :b]
            border += local[..., b:-1]
            gradient += local[..., -1]
            tall = rows[..., b:].reshape(-1, z.shape[0] + 1)
            square = tall.T @ tall
            corner, gradient_beta = corner + square[:-1, :-1], gradient_beta + square[:-1, -1]
            objective += float(square[-1, -1])
        objective += self._node_rows(x, noise, diagonal, gradient, residuals, extra)
        if extra is not None:
            self._node_columns(extra, noise, residuals, border, corner, gradient_beta)
        return Linearised(objective, diagonal, lower, gradient.ravel(), border.reshape(self.total * b, -1),
                          corner, gradient_beta, accel_rows, za, residuals, extra)

    @cached_property
    def _spans(self) -> list[tuple[slice, int, int]]:
        """(its intervals, first sample, last sample) of every stretch."""
        spans, done = [], 0
        for first, end in zip(np.concatenate([[0], self.ends[:-1]]), self.ends):
            count = int(end - first) - 1
            spans.append((slice(done, done + count), int(first), int(end) - 1))
            done += count
        return spans

    def _equations(self, jac: FloatArray, z: FloatArray, defect: FloatArray, weight: FloatArray) -> FloatArray:
        """Weighted rows of the equation of motion, (K, 2 n, 2 b + p + 1): by both ends' latents, by beta, residual."""
        n, count, columns = self.n, self.left.size, z.shape[0]
        out = np.empty((count, 2, n, 6 * n + columns + 1))
        ends = np.zeros((2, n, 2, 3, n, count))  # Gauss point, joint; end of interval, variable, its joint
        for i in range(n):
            np.multiply(jac[i].reshape(2, 2, 2, n, count), weight[i], out=ends[:, i, :, :2])
            ends[:, i, :, 2, i] = -weight[i] * self.collocation.torque_weights[:, :, None]
        out[..., : 6 * n] = ends.reshape(2, n, 6 * n, count).transpose(3, 0, 1, 2)
        out[..., 6 * n : -1] = (z * weight[:, None, None]).transpose(3, 2, 1, 0)
        out[..., -1] = (defect * weight[:, None, None]).transpose(2, 1, 0)
        return out.reshape(count, 2 * n, -1)

    def _channels(self, noise: Noise) -> list[tuple[str, int, float]]:
        """(channel, column of its latent, sigma) of every sensor that reads one latent directly."""
        n = self.n
        found = [(f"torque{i + 1}", 2 * n + i, float(noise.torque[i])) for i in range(n)]
        found += [(f"encoder{i + 1}", i, float(noise.encoder[i])) for i in range(n) if self.has_encoder[i]]
        return [*found, ("gyro", n, noise.gyro)] if self.has_imu else found

    def _node_rows(self, x: Latents, noise: Noise, diagonal: FloatArray, gradient: FloatArray,
                   residuals: dict[str, FloatArray], extra: Extra | None) -> float:
        """Add torque, encoder and gyro samples; returns their part of the objective."""
        n = self.n
        residuals["torque"] = x.u - self.torque
        residuals["encoder"] = x.q - self.angles
        values = {f"torque{i + 1}": residuals["torque"][:, i] for i in range(n)}
        values |= {f"encoder{i + 1}": residuals["encoder"][:, i] for i in range(n)}
        if self.has_imu:
            values["gyro"] = residuals["gyro"] = x.v[:, 0] - self.gyro
        total = 0.0
        for channel, column, sigma in self._channels(noise):
            r = values[channel]
            if extra is not None and channel in extra.readings:
                r += extra.readings[channel]  # a view: the residual of record moves with it
            diagonal[:, column, column] += 1.0 / sigma**2
            gradient[:, column] += r / sigma**2
            total += float(r @ r) / sigma**2
        return total

    def _node_columns(self, extra: Extra, noise: Noise, residuals: dict[str, FloatArray], border: FloatArray,
                      corner: FloatArray, gradient_beta: FloatArray) -> None:
        """Border and corner of the sizes through the sensors that read one latent directly."""
        p = self.mechanism.p
        for channel, column, sigma in self._channels(noise):
            if channel not in extra.reading_columns:
                continue
            c = extra.reading_columns[channel] / sigma**2
            kind, joint = channel.rstrip("0123456789"), channel.lstrip("abcdefghijklmnopqrstuvwxyz")
            r = residuals[kind][:, int(joint) - 1] if joint else residuals[kind]
            border[:, column, p:] += c.T
            corner[p:, p:] += c @ extra.reading_columns[channel].T
            gradient_beta[p:] += c @ r

    def _accelerometer(self, x: Latents, beta: FloatArray, extra: Extra | None
                       ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Rows (N, 2, b), residuals (N, 2) and border (N, 2, p) of the accelerometer's two axes.

        q1dd comes from the equation of motion at the sample, not from the cubic: friction that changes sign
        inside an interval makes the acceleration jump there, and the cubic's value at its end would carry
        that jump to the wrong side (measured: 5 % on the knee's Coulomb level).
        """
        m, n = self.mechanism, self.n
        q1, v1 = x.q[:, 0], x.v[:, 0]
        u = x.u if extra is None else x.u - extra.torque_at_samples.T
        qdd, slopes, z, inverse = self.collocation.at_samples(x.q, x.v, u, beta,
                                                                None if extra is None else extra.sample_slopes)
        ax, ay = accelerometer(q1, v1, qdd[:, 0], m.lever_arm, m.gravity_mps2)
        by_joint = np.zeros((self.total, 2, 3, n))
        by_joint[:, 0] = m.lever_arm * slopes[:, :, 0].transpose(1, 0, 2)
        rows = by_joint.reshape(self.total, 2, self.block)
        rows[:, 0, 0] += m.gravity_mps2 * np.cos(q1)
        rows[:, 1, 0] = m.gravity_mps2 * np.sin(q1)
        rows[:, 1, n] = -2.0 * m.lever_arm * v1
        border = np.zeros((self.total, 2, m.p))
        border[:, 0] = -m.lever_arm * (inverse[:, :1] @ z)[:, 0]
        residual = np.stack([ax - self.ax, ay - self.ay], axis=-1)
        if extra is None:
            return rows, residual, border
        added = np.zeros((self.total, 2, extra.sample_columns.shape[0]))
        added[:, 0] = -m.lever_arm * np.einsum("Nj,kjN->Nk", inverse[:, 0], extra.sample_columns)
        for axis, channel in enumerate(("accel_x", "accel_y")):
            if channel in extra.readings:
                residual[:, axis] += extra.readings[channel]
            if channel in extra.reading_columns:
                added[:, axis] += extra.reading_columns[channel].T
        return rows, residual, np.concatenate([border, added], axis=-1)

    def residuals_after(self, point: Linearised, step: FloatArray, step_beta: FloatArray,
                        index: NDArray[np.intp]) -> dict[str, FloatArray]:
        """Sensor residuals `step` (N, b) and `step_beta` (on columns `index`) away from `point`, to first order.
        """
        n, p = self.n, self.mechanism.p
        out = {"torque": point.residuals["torque"] + step[:, 2 * n:],
               "encoder": point.residuals["encoder"] + step[:, :n]}
        if self.has_imu:
            out["gyro"] = point.residuals["gyro"] + step[:, n]
            out["accel"] = (point.residuals["accel"] + np.einsum("kab,kb->ka", point.accel_rows, step)
                            + point.accel_border[:, :, index] @ step_beta)
        if point.extra is not None:
            size = np.zeros(len(point.gradient_beta))
            size[index] = step_beta
            for channel, columns in point.extra.reading_columns.items():
                moved = size[p:] @ columns
                if channel.startswith(("torque", "encoder")):
                    out[channel[:-1]][:, int(channel[-1]) - 1] += moved
                elif channel == "gyro":
                    out["gyro"] += moved
        return out

    def effective_samples(self, point: Linearised, p_diagonal: FloatArray, noise: Noise) -> dict[str, FloatArray]:
        """Degrees of freedom that the latents took from each channel, gamma = sum J P J^T / sigma^2."""
        n = self.n
        variance = np.einsum("kii->i", p_diagonal)
        taken = {"torque": variance[2 * n:] / noise.torque**2,
                 "encoder": variance[:n] / noise.encoder**2}
        if self.has_imu:
            taken["gyro"] = np.array([variance[n] / noise.gyro**2])
            a = point.accel_rows
            taken["accel"] = np.array([np.sum((a @ p_diagonal) * a) / noise.accel**2])
        return taken

