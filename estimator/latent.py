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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from estimator import compiled
from estimator.assembly import Samples, Sums, add_intervals, add_samples, padded
from estimator.collocation import Collocation
from estimator.linearised import Extra, Linearised
from estimator.mechanism import Mechanism, smooth_sign
from estimator.sensors import accelerometer
from estimator.signalset import IMU_COLUMNS, SignalSet

FloatArray = NDArray[np.float64]
PIECE = 1024
"""Intervals, or samples, that are worked on at a time: what they need stays in the processor's cache."""
TIGHT = 0.1
"""Standard deviation of the equation of motion at a Gauss point, as a share of the joint's torque noise: an
interval's two points then add half a per cent to the variance of its torque."""
REST_SPREAD = 5.0
"""Speeds below about this many times the rounding of sign(qd) may be rest: the estimated speed of a joint that
sticks is not zero but what its sensors' noise makes it."""


@cache
def keep_pages() -> None:
    """Make the C library keep memory that arrays gave back, up to 64 MB of it, instead of the system.

    A step makes and drops arrays of megabytes, and the system hands out every page of them anew and cleared: on a
    virtual machine half of a fit's time went there. GNU's allocator takes the largest block freed so far, up to 32 MB,
    for the size below which it keeps what is freed; this block is freed without ever being touched. Elsewhere it does
    nothing.
    """
    np.empty(31 * 2**20, dtype=np.uint8)


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


class LatentProblem:
    """All stretches of all runs on one stack of samples; see the module's text."""

    def __init__(self, signals: Sequence[SignalSet], mechanism: Mechanism, hold: str) -> None:
        keep_pages()
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
        self.rest: FloatArray | None = None
        """(N, n) variance [N^2 m^2] of the torque that dry friction may hold at each sample; see `rest_variance`."""
        self.foreseen: FloatArray | None = None
        """(n,) misfit of each joint's torque that the last step of a search foresaw; see `_inertia_gradient`."""
        if self.has_imu:
            self.gyro, self.ax, self.ay = (np.concatenate([s.imu[c] for s in signals]) for c in IMU_COLUMNS)

    def rest_variance(self, v: FloatArray, beta: FloatArray) -> FloatArray:
        """(N, n) what the rounded sign(qd) leaves open where a joint hardly moves, squared [N^2 m^2].

        A joint that sticks holds any torque up to its Coulomb level F; the model says F s(qd), |s| < 1. The
        difference, at most F (1 - |s|) with s rounded more widely, counts as noise of that sample's torque.
        (Measured on a leg that starts at rest against a spring: without this the spring's preload is 6 % off
        and five parameters 0.25 %, with it 0.7 % and 0.05 %.)
        """
        m = self.mechanism
        out = np.zeros((self.total, self.n))
        for k, parameter in enumerate(m.parameters):
            if parameter.term == "coulomb":
                j = parameter.at[0]
                out[:, j] += (beta[k] * (1.0 - np.abs(smooth_sign(v[:, j], REST_SPREAD * m.velocity_scale)))) ** 2
        return out

    def linearise(self, x: Latents, beta: FloatArray, noise: Noise, extra: Extra | None = None) -> Linearised:
        """Residuals, Gauss-Newton blocks and border at (x, beta); columns of `extra` follow those of beta."""
        b, n, width = self.block, self.n, 1 + self.mechanism.p
        if extra is not None:
            width += extra.sample_columns.shape[0]
        fast = compiled.ready()
        diagonal, lower = np.zeros((self.total, b, b)), np.zeros((self.total - 1, b, b))
        right = np.zeros((self.total, b, width))  # residual, then parameters
        sums = Sums(diagonal, lower, right)
        square, misfit = np.zeros((width, width)), np.zeros(n)
        for intervals, here, there in self._pieces(self.left):
            rows, columns = self._motion_rows(x, beta, noise, intervals, here, there, extra)
            square += np.sum(columns @ columns.swapaxes(1, 2), axis=0)
            misfit += np.sum(columns[:, 0] ** 2, axis=-1).reshape(n, 2).sum(axis=1)
            add_intervals(rows, here, there, sums, fast)
        residuals: dict[str, FloatArray] = {}
        accel = np.empty((self.total if self.has_imu else 0, 2, b + width))
        if self.has_imu:
            for start in range(0, self.total, PIECE):
                at = slice(start, min(start + PIECE, self.total))
                rows = self._accelerometer_rows(x, beta, at, extra)
                columns = rows[:, b:]
                square += np.sum(columns @ columns.swapaxes(1, 2), axis=0) / noise.accel**2
                add_samples(rows, at, 1.0 / noise.accel**2, sums, accel, fast)
            residuals["accel"] = accel[:, :, b]
        gradient, border = right[:, :, 0], right[:, :, 1:]
        objective, gradient_beta, corner = float(square[0, 0]), square[1:, 0], square[1:, 1:]
        objective += self._node_rows(x, noise, diagonal, gradient, residuals, extra)
        if extra is not None:
            self._node_columns(extra, noise, residuals, border, corner, gradient_beta)
        misfit += np.sum(residuals["torque"] ** 2 / self.torque_variance(noise), axis=0)
        gradient_beta[: self.mechanism.p] -= self._inertia_gradient(beta, misfit)
        return Linearised(objective, diagonal, lower, right.reshape(self.total * b, -1), corner, gradient_beta,
                          accel[:, :, :b], accel[:, :, b + 1 :], residuals, extra)

    def _inertia_gradient(self, beta: FloatArray, misfit: FloatArray) -> FloatArray:
        """(p,) what makes a passive joint's misfit count as one of acceleration, not of torque.

        Nothing measures a passive joint's torque: its equation is homogeneous in beta, and shrinking beta shrinks
        its misfit r. The density of what drives the joint's acceleration carries the joint's inertia m = a . beta,
        so r / m counts, whose gradient has - r^2 a / m^3 beside r r' / m^2. Without it a wrong model, or a weakly
        excited leg, runs off to beta = 0, and a right one is low by one part in the torque's signal to noise ratio.
        On the way there a misfit is that of latents which the same step puts right: more than `foreseen`, or at
        first more than the samples, to which it sums where the noise level is its own estimate, would overshoot.
        (Measured: counted in full it keeps beta 0.9 % high for the first four steps.)
        """
        out = np.zeros(self.mechanism.p)
        most = np.full(self.n, self.total) if self.foreseen is None else self.foreseen
        for j in self.mechanism.passive:
            a = self._inertia[:, j]
            m = float(a @ beta)
            if m > 0.0:
                out += min(misfit[j], most[j]) / m * a
        return out

    @cached_property
    def _inertia(self) -> FloatArray:
        """(p, n) diagonal of the inertia matrix, all joints straight, by parameter."""
        one, straight = np.eye(self.mechanism.p), np.zeros((1, self.n))
        return np.array([np.diag(self.mechanism.inertia_matrix(straight, b)[0]) for b in one])

    @staticmethod
    def _pieces(samples: NDArray[np.intp]) -> Iterator[tuple[slice, Samples, Samples]]:
        """`samples` piece by piece: which of them, those themselves, and the samples after them.

        Slices wherever a piece has no gap: they cost no copies.
        """
        for start in range(0, samples.size, PIECE):
            part = samples[start : start + PIECE]
            first, last = int(part[0]), int(part[-1])
            if last - first == part.size - 1:
                yield slice(start, start + part.size), slice(first, last + 1), slice(first + 1, last + 2)
            else:
                yield slice(start, start + part.size), part, part + 1

    def _motion_rows(self, x: Latents, beta: FloatArray, noise: Noise, intervals: slice,
                     here: Samples, there: Samples,
                     extra: Extra | None) -> tuple[FloatArray, FloatArray]:
        """Weighted rows of the equation of motion, (2 n, 2 b + 1 + p, padded K).

        Columns are both ends' latents, residual, parameters. Second are the last 1 + p alone.
        """
        c, n, p, b = self.collocation, self.n, self.mechanism.p, self.block
        motion = c.motion_between(np.stack([x.q[here].T, x.v[here].T, x.q[there].T, x.v[there].T], axis=1))
        z, own = c.evaluate(motion, beta)  # (p, n, 2, K), (n, 2, 5, n, K)
        count = z.shape[-1]
        w = c.torque_weights
        residual = (beta @ z.reshape(p, -1)).reshape(n, 2, count)
        residual -= w[:, 0, None] * x.u[here].T[:, None]
        residual -= w[:, 1, None] * x.u[there].T[:, None]
        added = None
        if extra is not None:
            residual += extra.torque[:, :, intervals]
            z = np.concatenate([z, extra.torque_columns[:, :, :, intervals]])
            added = None if extra.slopes is None else extra.slopes[..., intervals]
        weight = (1.0 / (TIGHT * noise.torque))[:, None, None]
        whole = np.zeros((n, 2, 2 * b + 1 + len(z), padded(count)))
        rows = whole[..., :count]
        ends = whole[:, :, : 2 * b].reshape(n, 2, 2, 3, n, -1)[..., :count]  # joint, Gauss point; end, variable, joint
        np.multiply(c.by_ends(own, added).reshape(n, 2, 2, 2, n, count),
                    weight[..., None, None, None], out=ends[:, :, :, :2])
        for i in range(n):
            ends[i, :, :, 2, i] = -weight[i] * w[:, :, None]
        np.multiply(residual, weight, out=rows[:, :, 2 * b])
        np.multiply(z.transpose(1, 2, 0, 3), weight[..., None], out=rows[:, :, 2 * b + 1 :])
        flat = whole.reshape(2 * n, -1, padded(count))
        return flat, flat[:, 2 * b :]

    def torque_variance(self, noise: Noise) -> FloatArray:
        """(N, n) of every torque sample [N^2 m^2]."""
        level = np.broadcast_to(noise.torque**2, (self.total, self.n))
        return level if self.rest is None else level + self.rest

    def torque_weight(self, noise: Noise) -> FloatArray:
        """(N, n) share of each torque sample's variance that is noise, not dry friction at rest."""
        return noise.torque**2 / self.torque_variance(noise)

    def _channels(self, noise: Noise) -> list[tuple[str, int, float | FloatArray]]:
        """(channel, column of its latent, variance) of every sensor that reads one latent directly."""
        n = self.n
        torque = self.torque_variance(noise)
        found: list[tuple[str, int, float | FloatArray]] = []
        found += [(f"torque{i + 1}", 2 * n + i, torque[:, i]) for i in range(n)]
        found += [(f"encoder{i + 1}", i, float(noise.encoder[i]) ** 2) for i in range(n) if self.has_encoder[i]]
        return [*found, ("gyro", n, noise.gyro**2)] if self.has_imu else found

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
        for channel, column, variance in self._channels(noise):
            r = values[channel]
            if extra is not None and channel in extra.readings:
                r += extra.readings[channel]  # a view: the residual of record moves with it
            diagonal[:, column, column] += 1.0 / variance
            gradient[:, column] += r / variance
            if extra is not None and channel in extra.by_torque:
                slope, other = extra.by_torque[channel], 2 * n + column % n
                diagonal[:, other, other] += slope**2 / variance
                diagonal[:, other, column] += slope / variance
                diagonal[:, column, other] += slope / variance
                gradient[:, other] += slope * r / variance
            total += float(r @ (r / variance))
        return total

    def _node_columns(self, extra: Extra, noise: Noise, residuals: dict[str, FloatArray], border: FloatArray,
                      corner: FloatArray, gradient_beta: FloatArray) -> None:
        """Border and corner of the sizes through the sensors that read one latent directly."""
        p = self.mechanism.p
        for channel, column, variance in self._channels(noise):
            if channel not in extra.reading_columns:
                continue
            c = extra.reading_columns[channel] / variance
            kind, joint = channel.rstrip("0123456789"), channel.lstrip("abcdefghijklmnopqrstuvwxyz")
            r = residuals[kind][:, int(joint) - 1] if joint else residuals[kind]
            border[:, column, p:] += c.T
            if channel in extra.by_torque:
                border[:, 2 * self.n + column % self.n, p:] += (extra.by_torque[channel] * c).T
            corner[p:, p:] += c @ extra.reading_columns[channel].T
            gradient_beta[p:] += c @ r

    def _accelerometer_rows(self, x: Latents, beta: FloatArray, here: Samples,
                            extra: Extra | None) -> FloatArray:
        """Rows (2, b + 1 + p, padded K) of the accelerometer's two axes: by the latents, residual, by the parameters.

        q1dd comes from the equation of motion at the sample, not from the cubic: friction that changes sign
        inside an interval makes the acceleration jump there, and the cubic's value at its end would carry
        that jump to the wrong side (measured: 5 % on the knee's Coulomb level).
        """
        m, n, b = self.mechanism, self.n, self.block
        lever, g = m.lever_arm, m.gravity_mps2
        q, v, u = (np.ascontiguousarray(a[here].T) for a in (x.q, x.v, x.u))
        added = None
        if extra is not None:
            u = u - extra.torque_at_samples[:, here]
            added = None if extra.sample_slopes is None else extra.sample_slopes[..., here]
        qdd, by_latents, by_beta, inverse = self.collocation.acceleration(q, v, u, beta, 0, added)
        ax, ay = accelerometer(q[0], v[0], qdd, lever, g)
        count = 0 if extra is None else extra.sample_columns.shape[0]
        whole = np.zeros((2, b + 1 + m.p + count, padded(qdd.size)))
        rows = whole[..., : qdd.size]
        rows[0, :b] = lever * by_latents.reshape(b, -1)
        rows[0, 0] += g * np.cos(q[0])
        rows[1, 0] = g * np.sin(q[0])
        rows[1, n] = -2.0 * lever * v[0]
        rows[0, b], rows[1, b] = ax - self.ax[here], ay - self.ay[here]
        rows[0, b + 1 : b + 1 + m.p] = lever * by_beta
        if extra is not None:
            rows[0, b + 1 + m.p :] = -lever * np.einsum("jN,kjN->kN", inverse, extra.sample_columns[:, :, here])
            for axis, channel in enumerate(("accel_x", "accel_y")):
                if channel in extra.readings:
                    rows[axis, b] += extra.readings[channel][here]
                if channel in extra.reading_columns:
                    rows[axis, b + 1 + m.p :] += extra.reading_columns[channel][:, here]
        return whole

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
            for channel, slope in point.extra.by_torque.items():
                j = int(channel[-1]) - 1
                out[channel[:-1]][:, j] += slope * step[:, 2 * n + j]
            for channel, columns in point.extra.reading_columns.items():
                moved = size[p:] @ columns
                if channel.startswith(("torque", "encoder")):
                    out[channel[:-1]][:, int(channel[-1]) - 1] += moved
                elif channel == "gyro":
                    out["gyro"] += moved
        return out

    def effective_samples(self, point: Linearised, p_diagonal: FloatArray, noise: Noise) -> dict[str, FloatArray]:
        """Degrees of freedom that the latents took from each channel, gamma = sum J P J^T / sigma^2.

        Torque samples count by the square of `torque_weight`: so much they say of the noise.
        """
        n = self.n
        variance = np.einsum("kii->ki", p_diagonal)
        taken = {"torque": np.sum(variance[:, 2 * n:] * self.torque_weight(noise) ** 2, axis=0) / noise.torque**2,
                 "encoder": variance[:, :n].sum(axis=0) / noise.encoder**2}
        for channel, slope in (point.extra.by_torque.items() if point.extra is not None else ()):
            kind, j = channel[:-1], int(channel[-1]) - 1
            u = 2 * n + j
            own = u if kind == "torque" else j
            both = slope**2 * variance[:, u] + 2.0 * slope * p_diagonal[:, own, u]
            if kind == "torque":
                both *= self.torque_weight(noise)[:, j] ** 2
            taken[kind][j] += both.sum() / (noise.torque if kind == "torque" else noise.encoder)[j] ** 2
        if self.has_imu:
            taken["gyro"] = np.array([variance[:, n].sum() / noise.gyro**2])
            a = point.accel_rows
            taken["accel"] = np.array([np.sum((a @ p_diagonal) * a) / noise.accel**2])
        return taken

