"""`LatentProblem`: the joint likelihood of one latent motion and the parameters, linearised.

Unknown at each sample: angle q, rate v and acting torque u of every joint (block size b = 3 joints); common:
beta. Where joints are `disturbed` there is also the coloured error e of each torque reading (b = 4 joints). Residuals,
each over its standard deviation:

    equation of motion at two Gauss points an interval   Z(q, v) beta - hold(u)        sigma_u * slack_of
    torque sample (zero on a passive joint)              u + e - y_u                   sigma_u
    disturbance, of time constant T                      e' - exp(-dt / T) e           s (1 - exp(-2 dt / T))^1/2
    encoder                                              q - y_q                       sigma_q
    gyro of an IMU on a link at angle t q                t v - y_g                     sigma_g
    its accelerometer                                    a(q, v, qdd) - y_a            sigma_a by axis

The passive joint's torque is exactly zero, so B Sigma_u B^T of (17) is singular; its sigma_u stands for what
the model gets wrong there. Where a rig declares correlations, of both axes or of the torques at one time, these
rows have their whole inverse covariance. Normal equations are block tridiagonal in the latents with a dense border for
beta; cost grows linearly with samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.likelihood import assembly_numba, correlated_torque
from estimator.likelihood.disturbance import Process, expected_score
from estimator.likelihood.memory import keep_pages, pieces, refuse_too_long
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import Accumulators, Extra, Latents, Linearised
from estimator.model import Collocation, Mechanism
from estimator.numerics import BlockTridiagonal
from estimator.signals import (
    Channel,
    SignalSet,
    by_run,
    encoder_level,
    encoder_of,
    imu_channels,
    imu_columns,
    lowpass,
    torque_of,
    total,
    white_noise_level,
)

PIECE = 1024
"""Intervals, or samples, that are worked on at a time: what they need stays in the processor's cache."""
DRIVEN_SLACK, PASSIVE_SLACK = 0.01, 0.1
"""Standard deviation of the equation of motion at a Gauss point, as a share of the joint's torque noise.

The equation holds exactly there, so this is numerical slack. A smaller beta makes of it a larger acceleration. So slack
at a driven joint biases beta low; at a passive joint `_inertia_gradient` prevents that. (Measured with an accelerometer
of 0.01 m/s^2: beta is 4.8 % low with 0.1 at driven joints, and right with 0.01. With 0.02 at a passive joint the
Cramer-Rao bound of a walker is 7 % wrong: doubles have too few digits.)"""
CURVED = 0.15
"""Share of the rate below which the measured torque's curve is its own and not its noise's."""


def slack_of(mechanism: Mechanism) -> FloatArray:
    """(n,) share of each joint's torque noise that the equation of motion may err by at a Gauss point."""
    share = np.full(mechanism.n, DRIVEN_SLACK)
    share[list(mechanism.passive)] = PASSIVE_SLACK
    return share


class LatentProblem:
    """All segments of all runs on one stack of samples; see the module's text.

    A search changes nothing of it: what a step finds is in the `State`, with the noise of each sample.
    """

    def __init__(self, signals: Sequence[SignalSet], mechanism: Mechanism, hold: str, disturbed: bool = False) -> None:
        keep_pages()
        self.mechanism, self.n, self.disturbed = mechanism, mechanism.n, disturbed
        self.block = (4 if disturbed else 3) * mechanism.n
        lengths = [len(s.time_s) for s in signals]
        self.ends = np.cumsum(lengths)
        self.total = int(self.ends[-1])
        refuse_too_long(self.total, self.block, 1 + mechanism.p)
        self.left = np.delete(np.arange(self.total - 1), self.ends[:-1] - 1)
        """Samples that begin an interval."""
        self.dt = 1.0 / signals[0].rate_hz
        self.collocation = Collocation(mechanism, self.dt, hold)
        self.torque = np.concatenate([s.torque for s in signals])
        self.between: FloatArray | None = None
        """(n, 2, K) torque at the Gauss points beyond what the latents at samples give."""
        self._signals = tuple(signals)
        self.curve()
        self.angles = np.concatenate([s.angles for s in signals])
        spread = [s.spread for s in signals if s.spread is not None]
        self.spread = np.concatenate(spread) if spread else None
        """(N, n) of `SignalSet`, where angles of a channel are not all read alike well"""
        self.run_starts = np.array([where.start for _, _, where in by_run(signals)])
        """First sample of each run."""
        self.has_encoder = np.isfinite(self.angles).all(axis=0)
        self.has_imu = bool(signals[0].imu)
        self.known_stiction: FloatArray | None = None
        """(N, 2, n) as `Noise.stiction`, where it is known beforehand."""
        self.sharpest = mechanism.velocity_scales
        """(n,) velocity [rad/s] over which a rig says that friction's sign is smoothed; see `likeliest_smoothing`"""
        self.imu_count = len(mechanism.imus) if self.has_imu else 0
        self.turned_by = [mechanism.joints_to(place.link) for place in mechanism.imus[: self.imu_count]]
        """Joints whose rates add up to what each IMU's gyro reads."""
        readings = [np.concatenate([s.imu[c] for s in signals]) for k in range(self.imu_count) for c in imu_columns(k)]
        shown = np.array(readings).reshape(self.imu_count, 3, self.total)
        self.gyro, self.accel = shown[:, 0].copy(), shown[:, 1:].copy()
        """(S, N), (S, 2, N) of S IMUs"""

    def curve(self, u: FloatArray | None = None) -> None:
        """Take the curve between samples from the slow part of u (N, n), by default the measured torque, if held so."""
        if self.collocation.hold == "smooth":
            rate = 1.0 / self.dt
            slow = ([s.low_passed("torque", CURVED * rate) for s in self._signals] if u is None else
                    [lowpass(part, CURVED * rate, rate) for part in np.split(u, self.ends[:-1])])
            self.between = self.collocation.between(np.concatenate(slow), self.ends)

    def with_stiction(self, known: FloatArray | None) -> Self:
        """The same, given what dry friction leaves open at each sample (N, 2, n)."""
        own = copy(self)
        own.known_stiction = known
        return own

    def smoothed_over(self, velocity: FloatArray | None) -> Self:
        """The same with friction's sign smoothed over `velocity` (n,) [rad/s]; None: as it is."""
        if velocity is None or np.array_equal(velocity, self.mechanism.velocity_scales):
            return self
        own = copy(self)
        own.mechanism = replace(self.mechanism, velocity_scale=tuple(velocity.tolist()))
        own.collocation = Collocation(own.mechanism, self.dt, self.collocation.hold)
        return own

    def stiction(self, noise: Noise) -> FloatArray | None:
        """(N, 2, n) in force: what is known beforehand, else what a search found."""
        return noise.stiction if self.known_stiction is None else self.known_stiction

    def log_volume(self, noise: Noise) -> float:
        """Sum over samples of the log standard deviations of all channels."""
        levels = [*noise.torque, *noise.encoder[np.isfinite(noise.encoder)]]
        if self.has_imu:
            levels += [*noise.gyro, *noise.accel.ravel()]
        return self.total * float(np.sum(np.log(levels)))

    def linearise(self, x: Latents, beta: FloatArray, noise: Noise, predicted_misfit: FloatArray | None = None
                  ) -> Linearised:
        """Residuals, Gauss-Newton blocks and border at (x, beta), for `_inertia_gradient` with the `predicted_misfit`
        (n,) of each joint's torque after the last step of a search."""
        return self._assembled(x, beta, noise, None, predicted_misfit)

    def motion_equations(self, x: Latents, parameters: FloatArray, noise: Noise) -> Linearised:
        """`linearise` for a search of the motion alone: without border, corner and gradient."""
        return self._assembled(x, parameters, noise, None, motion_alone=True)

    def _assembled(self, x: Latents, beta: FloatArray, noise: Noise, extra: Extra | None,
                   predicted_misfit: FloatArray | None = None, motion_alone: bool = False) -> Linearised:
        """`linearise` with columns of `extra` after those of beta, or `motion_equations`."""
        b, n, columns = self.block, self.n, 0 if extra is None else len(extra.sample_columns)
        width = 1 if motion_alone else 1 + self.mechanism.p + columns
        chain = BlockTridiagonal.zeros(self.total, b, width)  # right sides: residual, then parameters
        accumulators = Accumulators(chain, np.zeros((width, width)), np.zeros(n))
        weight = self.motion_weight(noise)
        for intervals, left in pieces(self.left, PIECE):
            assembly_numba.add_motion(self.collocation, x, beta, weight[:, intervals], intervals, left, extra,
                                      accumulators, self.between)
        residuals: dict[str, FloatArray] = {}
        accel = np.empty((self.imu_count, self.total, 2, b + width))
        if self.has_imu:
            for here, own in self._alike(noise):
                assembly_numba.add_accelerometer(self.collocation, x, beta, self.accel, own, here, extra,
                                                 accumulators, accel)
            residuals["accel"] = accel[..., b]
        upper = np.triu(accumulators.square)
        square, misfit = upper + np.triu(upper, 1).T, accumulators.misfit
        gradient, border = chain.right[:, :, 0], chain.right[:, :, 1:]
        objective, gradient_beta, corner = float(square[0, 0]), square[1:, 0], square[1:, 1:]
        variances = self.torque_variance(noise)
        objective += self._node_rows(x, variances, noise, chain.diagonal, gradient, residuals, extra)
        if extra is not None and not motion_alone:
            self._node_columns(extra, variances, noise, residuals, border, corner, gradient_beta)
        if self.disturbed:
            assert x.e is not None
            process = Process.of(noise, self.dt)
            process.add(chain, x.e, self.ends)
            squares = process.squares(x.e, self.ends)
            misfit += squares
            objective += float(squares.sum())
            residuals["e"] = x.e
        if motion_alone:
            return Linearised(objective, chain, corner, gradient_beta, accel, residuals, extra)
        misfit += np.einsum("kj,kj->j", residuals["torque"] ** 2, 1.0 / variances)
        gradient_beta[: self.mechanism.p] -= self._inertia_gradient(beta, misfit, predicted_misfit)
        if self.disturbed:
            freedom = np.minimum(squares, self.total * process.share(noise.torque**2))
            freedom[list(self.mechanism.passive)] = 0.0  # see _inertia_gradient
            gradient_beta[: self.mechanism.p] -= expected_score(self.mechanism, x.q, beta, freedom)
        return Linearised(objective, chain, corner, gradient_beta, accel, residuals, extra)

    def _inertia_gradient(self, beta: FloatArray, misfit: FloatArray, predicted: FloatArray | None) -> FloatArray:
        """(p,) gradient by which a passive joint's misfit counts as acceleration, not as torque: -r^2 a / m^3.

        A passive joint's equation is homogeneous in beta, so shrinking beta shrinks its misfit r. Therefore r / m
        counts, m = a . beta the joint's inertia. Without this a weakly excited leg diverges to beta = 0. r^2 is bounded
        by the `predicted` misfit, at first by the number of samples: the latents' step reduces the rest.
        """
        out = np.zeros(self.mechanism.p)
        most = np.full(self.n, self.total) if predicted is None else predicted
        for j in self.mechanism.passive:
            a = self.inertia_rows[:, j]
            m = float(a @ beta)
            if m > 0.0:
                out += min(misfit[j], most[j]) / m * a
        return out

    @cached_property
    def inertia_rows(self) -> FloatArray:
        """(p, n) diagonal of the inertia matrix, all joints straight, by parameter."""
        one, straight = np.eye(self.mechanism.p), np.zeros((1, self.n))
        return np.array([np.diag(self.mechanism.inertia_matrix(straight, b)[0]) for b in one])

    def _alike(self, noise: Noise) -> Iterator[tuple[slice, Noise]]:
        """Samples piece by piece, and the accelerometer's noise there."""
        scale = noise.scale
        ends = [self.total] if scale is None else [*self.run_starts[1:], self.total]
        start = 0
        for end in ends:
            own = noise if scale is None else replace(noise, accel=noise.accel * scale.accel[:, start])
            for first in range(start, end, PIECE):
                yield slice(first, min(first + PIECE, end)), own
            start = end

    def dry_levels(self, beta: FloatArray) -> dict[int, float]:
        """Joint to its level of dry friction near rest [N m] at parameters `beta`."""
        return {p.at[0]: float(b) for b, p in zip(beta, self.mechanism.parameters) if p.term == "coulomb"}

    @cached_property
    def shown(self) -> Noise:
        """Noise levels that differences between neighbouring samples show; inf for what is not measured."""
        encoder = [encoder_level(self.angles[:, j]) if self.has_encoder[j] else np.inf for j in range(self.n)]
        torque = np.array([white_noise_level(t) for t in self.torque.T])
        if not self.has_imu:
            return Noise(torque, np.array(encoder))
        return Noise(torque, np.array(encoder), np.array([white_noise_level(g) for g in self.gyro]),
                     np.array([[white_noise_level(a) for a in axes] for axes in self.accel]))

    @cached_property
    def torque_spread(self) -> FloatArray:
        """(n,) standard deviation of each joint's measured torque [N m]."""
        return np.std(self.torque, axis=0)

    def motion_weight(self, noise: Noise) -> FloatArray:
        """(n, K) of the equation of motion at the Gauss points of every interval [1/(N m)]."""
        level = np.broadcast_to(self.motion_level(noise) ** 2, (self.n, self.left.size))
        rest = self.stiction(noise)
        return np.sqrt(1.0 / (level if rest is None else level + rest[self.left, 1].T))

    def motion_level(self, noise: Noise) -> FloatArray:
        """(n, K) standard deviation there by noise, not by rest [N m]; (n, 1) where runs are alike."""
        level = (slack_of(self.mechanism) * noise.torque)[:, None]
        return level if noise.scale is None else level * noise.scale.torque[self.left].T

    def torque_level(self, noise: Noise) -> FloatArray:
        """(N, n) standard deviation of every torque sample's noise [N m]."""
        level = np.broadcast_to(noise.torque, (self.total, self.n))
        return level if noise.scale is None else level * noise.scale.torque

    def torque_variance(self, noise: Noise) -> FloatArray:
        """(N, n) of every torque sample [N^2 m^2]."""
        level = np.broadcast_to(noise.torque**2, (self.total, self.n))
        level = level if noise.scale is None else level * noise.scale.torque**2
        rest = self.stiction(noise)
        return level if rest is None else level + rest[:, 0]

    def angle_variance(self, joint: int, noise: Noise) -> float | FloatArray:
        """Variance of a joint's encoder [rad^2]; (N,) where its readings are not alike."""
        level, scale = float(noise.encoder[joint]) ** 2, self.angle_scale(noise)
        return level if scale is None else level * scale[:, joint] ** 2

    def gyro_variance(self, imu: int, noise: Noise) -> float | FloatArray:
        """Variance of an IMU's gyro [rad^2/s^2]; (N,) where runs are not alike."""
        level = float(noise.gyro[imu]) ** 2
        return level if noise.scale is None else level * noise.scale.gyro[imu] ** 2

    def angle_scale(self, noise: Noise) -> FloatArray | None:
        """(N, n) standard deviation of each angle over its channel's level; None where all are alike."""
        if noise.scale is None:
            return self.spread
        return noise.scale.encoder if self.spread is None else noise.scale.encoder * self.spread

    def torque_weight(self, noise: Noise) -> FloatArray:
        """(N, n) share of each torque sample's variance that is noise, not dry friction at rest; see also
        `correlated_torque.whole_samples`."""
        share = self.torque_level(noise) ** 2 / self.torque_variance(noise)
        if noise.torque_correlation is None:
            return share
        return correlated_torque.whole_samples(share, self.mechanism.actuated)

    def channels(self, variances: FloatArray, noise: Noise
                 ) -> list[tuple[Channel, tuple[int, ...], float | FloatArray]]:
        """(channel, columns of the latents, variance) of every sensor that reads one latent, or a sum of them."""
        n = self.n
        found: list[tuple[Channel, tuple[int, ...], float | FloatArray]] = []
        if noise.torque_correlation is None:
            found += [(torque_of(i), tuple(range(2 * n + i, self.block, n)), variances[:, i]) for i in range(n)]
        found += [(encoder_of(i), (i,), self.angle_variance(i, noise)) for i in range(n) if self.has_encoder[i]]
        return found + [(imu_channels(k)[0], tuple(n + j for j in joints), self.gyro_variance(k, noise))
                        for k, joints in enumerate(self.turned_by)]

    def imu_readings(self) -> dict[Channel, FloatArray]:
        """(N,) what each sensor of the IMUs read."""
        return {channel: values for k in range(self.imu_count)
                for channel, values in zip(imu_channels(k), (self.gyro[k], *self.accel[k]))}

    def _node_rows(self, x: Latents, variances: FloatArray, noise: Noise, diagonal: FloatArray, gradient: FloatArray,
                   residuals: dict[str, FloatArray], extra: Extra | None) -> float:
        """Add torque (of `variances`), encoder and gyro samples; returns their part of the objective."""
        n = self.n
        residuals["torque"] = x.u - self.torque if x.e is None else x.u + x.e - self.torque
        residuals["encoder"] = x.q - self.angles
        if self.has_imu:
            residuals["gyro"] = np.array([total(x.v.T, joints) for joints in self.turned_by]) - self.gyro
        objective = 0.0
        for channel, columns, variance in self.channels(variances, noise):
            r, weight = of_channel(residuals, channel), 1.0 / variance
            if extra is not None and channel in extra.readings:
                r += extra.readings[channel]  # a view: the residual of record moves with it
            weighted = weight * r
            for column in columns:
                gradient[:, column] += weighted
                for other in columns:
                    diagonal[:, column, other] += weight
            if extra is not None and channel in extra.by_torque:
                slope, other = extra.by_torque[channel], 2 * n + columns[0] % n
                diagonal[:, other, other] += slope**2 * weight
                for column in columns:
                    diagonal[:, other, column] += slope * weight
                    diagonal[:, column, other] += slope * weight
                gradient[:, other] += slope * weighted
            objective += float(r @ weighted)
        if noise.torque_correlation is not None:
            precision = noise.torque_precision(variances)
            objective += correlated_torque.add_samples(residuals["torque"], precision, extra,
                                                       diagonal[:, 2 * n : 3 * n, 2 * n : 3 * n],
                                                       gradient[:, 2 * n : 3 * n])
        return objective

    def _node_columns(self, extra: Extra, variances: FloatArray, noise: Noise, residuals: dict[str, FloatArray],
                      border: FloatArray, corner: FloatArray, gradient_beta: FloatArray) -> None:
        """Border and corner of the sizes through the sensors that read one latent directly."""
        p = self.mechanism.p
        for channel, columns, variance in self.channels(variances, noise):
            if channel not in extra.reading_columns:
                continue
            which, values = extra.reading_columns[channel]
            c, place = values / variance, p + which
            for column in columns:
                border[:, column, place] += c.T
            if channel in extra.by_torque:
                border[:, 2 * self.n + columns[0] % self.n, place] += (extra.by_torque[channel] * c).T
            corner[np.ix_(place, place)] += c @ values.T
            gradient_beta[place] += c @ of_channel(residuals, channel)
        if noise.torque_correlation is not None:
            correlated_torque.add_columns(residuals["torque"], noise.torque_precision(variances), extra,
                                          border[:, 2 * self.n : 3 * self.n, p:], corner[p:, p:], gradient_beta[p:])

    def residuals_after(self, point: Linearised, step: FloatArray, step_beta: FloatArray,
                        index: NDArray[np.intp]) -> dict[str, FloatArray]:
        """Sensor residuals `step` (N, b) and `step_beta` (on columns `index`) away from `point`, to first order."""
        n, p = self.n, self.mechanism.p
        out = {"torque": point.residuals["torque"] + step[:, 2 * n : 3 * n],
               "encoder": point.residuals["encoder"] + step[:, :n]}
        if self.disturbed:
            out["torque"] += step[:, 3 * n :]
            out["e"] = point.residuals["e"] + step[:, 3 * n :]
        if self.has_imu:
            turned = step[:, n : 2 * n].T
            out["gyro"] = point.residuals["gyro"] + np.array([total(turned, joints) for joints in self.turned_by])
            by_beta = np.zeros(point.accel.shape[3] - self.block)
            by_beta[0], by_beta[1 + index] = 1.0, step_beta
            out["accel"] = np.einsum("snab,nb->sna", point.accel_rows, step) + point.accel[..., self.block :] @ by_beta
        if point.extra is not None:
            size = np.zeros(len(point.gradient_beta))
            size[index] = step_beta
            for channel, slope in point.extra.by_torque.items():
                of_channel(out, channel)[:] += slope * step[:, 2 * n + (channel.joint or 0)]
            for channel, (which, values) in point.extra.reading_columns.items():
                if channel.kind in out:  # an accelerometer's are in its rows
                    of_channel(out, channel)[:] += size[p + which] @ values
        return out


def of_channel(residuals: Mapping[str, FloatArray], channel: Channel) -> FloatArray:
    """(N,) of a torque, encoder or gyro channel, a view."""
    found, number = residuals[channel.kind], channel.joint or 0
    return found[number] if channel.kind == "gyro" else found[:, number]
