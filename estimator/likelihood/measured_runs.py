"""`MeasuredRuns`: all segments of all runs on one stack of samples, and the noise of each."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Self

import numpy as np

from daq import FloatArray
from estimator.effects import Commanded, Record
from estimator.likelihood import correlated_torque
from estimator.likelihood.command_record import commands_at
from estimator.likelihood.noise import Noise
from estimator.model import Collocation, Mechanism, curves
from estimator.signals import (
    GYRO,
    SLOW_SHARE,
    Channel,
    SignalSet,
    by_run,
    encoder_level,
    encoder_of,
    imu_channels,
    imu_columns,
    lowpass,
    torque_of,
    white_noise_level,
)

DRIVEN_SLACK, PASSIVE_SLACK = 0.01, 0.1
"""Standard deviation of the equation of motion at a Gauss point, as a share of the joint's torque noise.

The equation holds exactly there, so this is numerical slack. A smaller beta makes of it a larger acceleration. So slack
at a driven joint biases beta low; at a passive joint `LatentProblem._inertia_gradient` prevents that. (Measured with an
accelerometer of 0.01 m/s^2: beta is 4.8 % low with 0.1 at driven joints, and right with 0.01. With 0.02 at a passive
joint the Cramer-Rao bound of a walker is 7 % wrong: doubles have too few digits.)"""
CURVED = 0.15
"""Share of the rate below which the measured torque's curve is its own and not its noise's."""
SLOW_HZ = 12.0
"""Cut-off below which effects see the measured rate."""


def slack_of(mechanism: Mechanism) -> FloatArray:
    """(n,) share of each joint's torque noise that the equation of motion may err by at a Gauss point."""
    share = np.full(mechanism.n, DRIVEN_SLACK)
    share[list(mechanism.passive)] = PASSIVE_SLACK
    return share


class MeasuredRuns:
    """Readings at N samples, the grid between them, and variances under given noise levels."""

    def __init__(self, signals: Sequence[SignalSet], mechanism: Mechanism, hold: str) -> None:
        self.mechanism, self.n = mechanism, mechanism.n
        self.signals = tuple(signals)
        self.ends = np.cumsum([len(s.time_s) for s in signals])
        self.total = int(self.ends[-1])
        self.left = np.delete(np.arange(self.total - 1), self.ends[:-1] - 1)
        """Samples that begin an interval."""
        self.dt = 1.0 / signals[0].rate_hz
        self.collocation = Collocation(mechanism, self.dt, hold)
        self.torque = np.concatenate([s.torque for s in signals])
        self.between: FloatArray | None = None
        """(n, 2, K) torque at the Gauss points beyond what the latents at samples give: of the measured torque."""
        if curves(hold):
            self.between = self._curve([s.low_passed("torque", CURVED / self.dt) for s in signals])
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

    def _curve(self, slow: Sequence[FloatArray]) -> FloatArray | None:
        return self.collocation.between(np.concatenate(slow), self.ends)

    def curved_by(self, u: FloatArray) -> Self:
        """The same with the curve of a smooth torque between samples from u (N, n), not from the measured torque."""
        if self.between is None:
            return self
        own, rate = copy(self), 1.0 / self.dt
        own.between = self._curve([lowpass(part, CURVED * rate, rate) for part in np.split(u, self.ends[:-1])])
        return own

    def delayed(self, late: float) -> Self:
        """The same with a torque that acts later by `late` [samples], see `Collocation`."""
        own = copy(self)
        own.collocation = Collocation(self.mechanism, self.dt, self.collocation.hold, late)
        return own

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

    def log_sensors(self, noise: Noise) -> float:
        """Sum over samples of the log standard deviations of encoders and IMUs."""
        levels = [*noise.encoder[np.isfinite(noise.encoder)], *noise.gyro, *noise.accel.ravel()]
        of_runs = (values for kind, values in noise.scale.by_kind() if kind != "torque") if noise.scale else ()
        return self.total * float(np.sum(np.log(levels))) + sum(float(np.sum(np.log(values))) for values in of_runs)

    @cached_property
    def commands(self) -> tuple[Commanded, Commanded] | None:
        """Commands of position loops at the samples and at the Gauss points; None where not all runs have any."""
        found = commands_at(self.signals, self.left, self.dt)
        if found is None or not set(np.flatnonzero(found[0].follows)) <= set(self.mechanism.followers):
            return found
        return replace(found[0], closed=True), replace(found[1], closed=True)

    @property
    def by_law(self) -> bool:
        """Whether all loops act on the latent motion: their joints' torque is the law's, and nobody measured it."""
        return self.commands is not None and self.commands[0].closed

    @property
    def closed(self) -> bool:
        """Whether every driven joint has a position loop, so that its commands alone make the motion."""
        driven = list(self.mechanism.actuated)
        return self.commands is not None and bool(driven) and bool(self.commands[0].follows[driven].all())

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
        level = slack_of(self.mechanism) * noise.torque
        level = (np.hypot(level, noise.unseen) if noise.unseen.size else level)[:, None]
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

    def imu_readings(self) -> dict[Channel, FloatArray]:
        """(N,) what each sensor of the IMUs read."""
        return {channel: values for k in range(self.imu_count)
                for channel, values in zip(imu_channels(k), (self.gyro[k], *self.accel[k]))}

    @cached_property
    def record(self) -> Record:
        """The sensors' readings as effects see them."""
        def slow(column: str, cutoff_hz: float) -> FloatArray:
            return np.concatenate([s.low_passed(column, cutoff_hz) for s in self.signals])

        with_encoder = [int(j) for j in np.flatnonzero(self.has_encoder)]
        readings = {torque_of(j): self.torque[:, j] for j in range(self.n)}
        readings |= {encoder_of(j): self.angles[:, j] for j in with_encoder}
        torques = np.ascontiguousarray(slow("torque", SLOW_SHARE / self.dt).T)
        low_passed = {torque_of(j): torque for j, torque in enumerate(torques)}
        readings |= self.imu_readings()
        if self.has_imu:
            low_passed[GYRO] = slow(imu_columns(0)[0], SLOW_HZ)
        derivatives = {j: self._derivatives(self.angles[:, j]) for j in with_encoder}
        return Record(readings, low_passed, {j: rate for j, (rate, _) in derivatives.items()},
                      {j: acceleration for j, (_, acceleration) in derivatives.items()})

    def _derivatives(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N,) first and second differences of an angle over time."""
        parts = np.split(angle, self.ends[:-1])
        second = [np.pad(np.diff(part, 2) / self.dt**2, 1, mode="edge") for part in parts]
        return np.concatenate([np.gradient(part, self.dt) for part in parts]), np.concatenate(second)
