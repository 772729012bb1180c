"""`Noise`: standard deviations of all channels, what single samples add to them, and the correlations of a rig."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from daq import FloatArray, IndexArray
from estimator.likelihood.noise_scale import NoiseScale
from estimator.options import accel_level, encoder_level, gyro_level, torque_level

EXACT_ENCODER = 1e-8
"""Standard deviation that stands for an encoder without noise [rad]: the collocation's own error over 10 ms."""


def _no_gyro() -> FloatArray:
    return np.zeros(0)


def _no_accelerometer() -> FloatArray:
    return np.zeros((0, 2))


@dataclass(frozen=True)
class Noise:
    """Standard deviations in force."""

    torque: FloatArray
    """(n,) [N m]; on a passive joint what the model gets wrong."""
    encoder: FloatArray
    """(n,) [rad]; inf for a joint without an encoder."""
    gyro: FloatArray = field(default_factory=_no_gyro)
    """(S,) of each IMU [rad/s]"""
    accel: FloatArray = field(default_factory=_no_accelerometer)
    """(S, 2) of its accelerometer's x and y axes [m/s^2]"""
    accel_correlation: float = 0.0
    """Between these two of one IMU, at one sample."""
    torque_correlation: FloatArray | None = None
    """(n, n) between the joints' torque samples at one time; None where they are independent."""
    disturbance: FloatArray = field(default_factory=_no_gyro)
    """(n,) standard deviation of each joint's coloured disturbance torque [N m], 0 where a joint has none; empty where
    no joint has one."""
    time_constant: FloatArray = field(default_factory=_no_gyro)
    """(n,) its time constant [s]."""
    unseen: FloatArray = field(default_factory=_no_gyro)
    """(n,) standard deviation of the torque between samples that no sample shows [N m], at each Gauss point; empty
    where there is none. Samples of a controller's torque show some of its steps."""
    scale: NoiseScale | None = None
    """Of each of the N samples of one record, where runs differ in noise."""
    stiction: FloatArray | None = None
    """(N, 2, n) variance [N^2 m^2] of the unknown friction torque at each sample and in the interval after it.

    None before a search; see `find_stiction`.
    """

    def at(self, samples: slice | IndexArray) -> Noise:
        """At some of the samples of its record."""
        return replace(self, scale=self.scale and self.scale.at(samples),
                       stiction=None if self.stiction is None else self.stiction[samples])

    def with_declared(self, known: Mapping[str, float], actuated: Collection[int]) -> Noise:
        """These levels, with those that are `known` by their keys of `[noise]` in their place; see EXACT_ENCODER."""
        def given(level: float | None, own: float) -> float:
            return own if level is None else level

        torque = [given(torque_level(known, j, j in actuated), own) for j, own in enumerate(self.torque)]
        encoder = [max(given(encoder_level(known, j), own), EXACT_ENCODER) if np.isfinite(own) else own
                   for j, own in enumerate(self.encoder)]
        gyro = [given(gyro_level(known, k), own) for k, own in enumerate(self.gyro)]
        accel = [[given(accel_level(known, i, k), own) for i, own in enumerate(axes)]
                 for k, axes in enumerate(self.accel)]
        return replace(self, torque=np.array(torque), encoder=np.array(encoder), gyro=np.array(gyro),
                       accel=np.reshape(accel, self.accel.shape))

    def levels(self) -> Noise:
        """Without what belongs to single samples: the noise of any record."""
        return replace(self, scale=None, stiction=None)

    def accel_precision(self, imu: int = 0) -> FloatArray:
        """(2, 2) inverse covariance of both axes of one IMU at one sample [s^4/m^2]."""
        (x, y), own = self.accel[imu], 1.0 - self.accel_correlation**2
        mixed = -self.accel_correlation / (own * x * y)
        return np.array([[1.0 / (own * x**2), mixed], [mixed, 1.0 / (own * y**2)]])

    def torque_precision(self, variances: FloatArray) -> FloatArray:
        """(N, n, n), or (1, n, n) where all samples are alike, inverse covariance of torque samples.

        `variances` (N, n) [N^2 m^2] have what dry friction may hold in them, which is each joint's own.
        """
        assert self.torque_correlation is not None
        shared = np.outer(self.torque, self.torque) * self.torque_correlation
        diagonal = np.arange(self.torque.size)
        alike = variances.strides[0] == 0  # one level, broadcast
        out = np.repeat(shared[None], 1 if alike else len(variances), axis=0)
        if self.scale is not None:
            out = out * self.scale.torque[:, :, None] * self.scale.torque[:, None, :]
        out[:, diagonal, diagonal] = variances[: len(out)]
        return np.asarray(np.linalg.inv(out), dtype=np.float64)
