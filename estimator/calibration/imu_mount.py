"""Mounting of an IMU on a link that swings about a fixed axis: axes, place and offsets, from its own six readings.

The chip's readings are those of the link's axes x (tangential), y (away from the axis) and z (about which the gyro
reads the rate), turned by R, with r = l y + e x the way from the axis to the chip:

    gyro  = R^T (0, 0, qd) + b_g
    accel = R^T (l qdd - e qd^2 + g sin q, -l qd^2 - e qdd - g cos q, 0) + b_a

The motion is the gyro's: its integral from a free angle at the start of each window, and its slope. A swing is slow:
behind a low pass too little noise is left in them to shorten the lever arm. Intervals come from leaving out one window
after the other (delete-one jackknife), so that they hold for coloured errors too, and hold white noise at least.

The rows of R are the link's axes in the chip's frame. Only gravity's size, not its direction, is known beforehand.
Where q = 0 is, a swing does not say: that is the pose in which the link hangs at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from daq import FloatArray
from estimator.calibration.windows import cut
from estimator.errors import FitError
from estimator.numerics import student_quantile
from estimator.signals import lowpass, white_noise_level

WINDOW_S = 1.0
SWING_HZ, OVERSAMPLED = 8.0, 4
"""Above the frequency links ring; samples of the thinned record a period of it."""
ROUNDS = 2
"""Fits, each with the noise levels that the one before leaves."""
LEAST_SWING_RAD = 0.3
"""From end to end."""
FEWEST = 4
"""Windows."""
TOLD_APART = 25.0
"""Difference of the two hands' deviance below which the data does not tell them apart."""
PRIOR = np.array([0.5, 0.5, 1.0, 1.0, 1.0, 3.0, 3.0, 3.0, 3.0, 1.0])
"""Spread of theta: two tilts of the axis [rad], gyro bias [rad/s], accelerometer bias [m/s2], l and e [m]."""
STEP = 1e-6


@dataclass(frozen=True)
class Readings:
    """Six columns of one record without a gap, in the chip's axes."""

    time_s: FloatArray
    gyro_radps: FloatArray
    """(n, 3)"""
    accel_mps2: FloatArray
    """(n, 3)"""


@dataclass(frozen=True)
class MountFit:
    """Values with half of each 95 % interval."""

    mount: FloatArray
    """(3, 3) rows: the link's x, y, z in the chip's frame."""
    angle_half: FloatArray
    """(3,) about the link's x, y and z [rad], noise alone."""
    lever_m: float
    lever_half: float
    side_offset_m: float
    """Side offset e: distance of the chip from the line through the axis along y."""
    side_offset_half: float
    gyro_bias_radps: FloatArray
    gyro_bias_half: FloatArray
    accel_bias_mps2: FloatArray
    """(3,) residual bias, in the chip's axes."""
    accel_bias_half: FloatArray
    noise: tuple[float, float]
    """Of gyro [rad/s] and accelerometer [m/s2], one sample."""
    swing_rad: float
    """From end to end of the widest record."""

    def turned_round(self) -> MountFit:
        """The same with the other direction of turning called positive, which the IMU alone cannot tell."""
        return MountFit(self.mount * np.array([[-1.0], [1.0], [-1.0]]), self.angle_half, self.lever_m, self.lever_half,
                        -self.side_offset_m, self.side_offset_half, self.gyro_bias_radps, self.gyro_bias_half,
                        self.accel_bias_mps2, self.accel_bias_half, self.noise, self.swing_rad)


def fit_mount(swings: Sequence[Readings], rests: Sequence[tuple[FloatArray, FloatArray]], z_hint: FloatArray,
              gravity_mps2: float) -> MountFit:
    """Mount, lever arm and offsets from records of swings and of rest.

    `rests`: (mean accelerometer reading (3,), half of its 95 % interval (3,)) by record of the link hanging still;
    `z_hint` (3,): about where the axis points in the chip's frame, for its sign. Raises `FitError` where the swings
    are too small or too short to tell.
    """
    down = -np.mean([mean for mean, _ in rests], axis=0)
    axis = _axis(swings, z_hint)
    parts = [_windows(one, axis) for one in swings]
    swing = max(float(np.ptp(part.start[:, None] + part.turned @ axis)) if len(part.start) else 0.0 for part in parts)
    if swing < LEAST_SWING_RAD:
        raise FitError(f"the link swung over {swing:.2f} rad, {LEAST_SWING_RAD} are needed: push it harder and record "
                       "again")
    least = min(part.time_s.shape[1] for part in parts)
    windows = _Windows(*(np.concatenate([x[:, :least] if x.ndim > 1 else x for x in arrays]) for arrays in zip(*parts)))
    right, left = (_fit(windows, down, axis, hand, gravity_mps2) for hand in (1.0, -1.0))
    if abs(right.deviance - left.deviance) < TOLD_APART:
        raise FitError("the swings do not tell on which side the chip's axes lie: swing wider and for longer")
    noise = [float(np.mean([white_noise_level(x) for one in swings for x in (one.gyro_radps, one.accel_mps2)[k].T]))
             for k in (0, 1)]
    return _referred(min(right, left, key=lambda fit: fit.deviance), rests, (noise[0], noise[1]), swing)


class _Windows(NamedTuple):
    """Low-passed readings in windows."""

    time_s: FloatArray
    """(W, L) since its start"""
    gyro: FloatArray
    """(W, L, 3)"""
    turned: FloatArray
    """(W, L, 3) integral of the gyro since its start [rad]"""
    slope: FloatArray
    """(W, L, 3) of the gyro [rad/s2]"""
    accel: FloatArray
    """(W, L, 3)"""
    start: FloatArray
    """(W,) about the angle at its start"""


def _windows(s: Readings, axis: FloatArray) -> _Windows:
    """Windows of a record without its ends, where filters ring."""
    rate = (s.time_s.size - 1) / float(s.time_s[-1] - s.time_s[0])
    cutoff = min(SWING_HZ, 0.2 * rate)
    gyro, accel = (lowpass(x, cutoff, rate) for x in (s.gyro_radps, s.accel_mps2))
    turned = cumulative_trapezoid(gyro, s.time_s, axis=0, initial=0)
    q = (turned - gyro.mean(axis=0) * (s.time_s - s.time_s[0])[:, None]) @ axis
    every, edge = max(int(rate / (OVERSAMPLED * cutoff)), 1), int(rate / cutoff)
    length = int(WINDOW_S * rate / every)
    time_s, gyro, turned, slope, accel, q = (cut(x[edge : len(x) - edge : every], length) for x in (
        s.time_s, gyro, turned, np.gradient(gyro, s.time_s, axis=0), accel, q - q.mean()))
    return _Windows(time_s - time_s[:, :1], gyro, turned - turned[:, :1], slope, accel, q[:, 0])


class _Fit(NamedTuple):
    theta: FloatArray
    """(10,) as `PRIOR`"""
    covariance: FloatArray
    """(10, 10)"""
    freedom: int
    deviance: float
    """-2 log likelihood up to a constant"""
    rows: FloatArray
    """(3, 3) of R before its tilt"""

    @property
    def half(self) -> FloatArray:
        """(10,) half of each 95 % interval."""
        return student_quantile(self.freedom) * np.sqrt(np.diag(self.covariance))


def _fit(windows: _Windows, down: FloatArray, axis: FloatArray, hand: float, gravity_mps2: float) -> _Fit:
    """The fit for right-handed (+1) or left-handed (-1) axes."""
    from scipy.optimize import least_squares  # 0.2 s to import

    y = down - (down @ axis) * axis
    if np.linalg.norm(y) < 0.5 * np.linalg.norm(down):
        raise FitError("gravity points along the axis of the swing: the rest record is of another pose, or the link "
                       "did not swing about a level axis")
    y /= np.linalg.norm(y)
    rows, p, count = np.array([hand * np.cross(y, axis), y, axis]), PRIOR.size, len(windows.start)
    if count < FEWEST:
        raise FitError(f"{count} s of swing are too few, at least {FEWEST} are needed: record for longer")
    first = np.zeros(p)
    first[2:5] = windows.gyro.mean(axis=(0, 1))
    x, level = np.concatenate([first, windows.start]), np.ones(2)
    shape = (count, -1, 2, 3)

    def left(x: FloatArray) -> FloatArray:
        read = unexplained(rows, x[:p], x[p:], windows, gravity_mps2).reshape(shape) / level[:, None]
        return np.concatenate([read.ravel(), (x[:p] - first) / PRIOR])

    for _ in range(ROUNDS):
        found = least_squares(left, x, x_scale="jac")
        x, level = found.x, level * np.sqrt(np.mean(left(found.x)[:-p].reshape(shape) ** 2, axis=(0, 1, 3)))
    jacobian, residual = (np.asarray(some)[:-p].reshape(count, -1, *some.shape[1:]) for some in (found.jac, found.fun))
    own, of_theta = np.einsum("wlw->wl", jacobian[:, :, p:]), jacobian[:, :, :p]
    of_theta = of_theta - own[:, :, None] * (np.einsum("wl,wlp->wp", own, of_theta) / np.sum(own**2, axis=1)[:, None]
                                             )[:, None]
    shares, scores = np.einsum("wlp,wlq->wpq", of_theta, of_theta), np.einsum("wlp,wl->wp", of_theta, residual)
    whole = shares.sum(axis=0) + np.diag(PRIOR**-2.0)
    moves = np.linalg.solve(whole - shares, scores[:, :, None])[:, :, 0]
    moves -= moves.mean(axis=0)
    samples = float(count * WINDOW_S * 2.0 * SWING_HZ)
    deviance = 6.0 * samples * float(np.log(level).sum())
    jackknife, noise = (count - 1) / count * moves.T @ moves, 0.5 * OVERSAMPLED * np.linalg.inv(whole)
    wider = np.sqrt(np.maximum(np.diag(noise) / np.diag(jackknife), 1.0))
    return _Fit(x[:p], jackknife * np.outer(wider, wider), count - 1, deviance, rows)


def _axis(swings: Sequence[Readings], hint: FloatArray) -> FloatArray:
    """Main direction of the gyro's readings, on the side of `hint`."""
    turning = np.vstack([s.gyro_radps - s.gyro_radps.mean(axis=0) for s in swings])
    axis = np.linalg.svd(turning[:: max(len(turning) // 20000, 1)], full_matrices=False)[2][0]
    return axis if axis @ hint >= 0 else -axis


def unexplained(rows: FloatArray, theta: FloatArray, start: FloatArray, windows: _Windows, gravity_mps2: float
                ) -> FloatArray:
    """(W, L, 6) gyro and accelerometer less what the module's equations make of the gyro."""
    turn = Rotation.from_rotvec([theta[0], theta[1], 0.0]).as_matrix() @ rows
    rate, slope = (windows.gyro - theta[2:5]) @ turn[2], windows.slope @ turn[2]
    q = start[:, None] + (windows.turned - theta[2:5] * windows.time_s[..., None]) @ turn[2]
    lever, side_offset = theta[8], theta[9]
    accel_x = lever * slope - side_offset * rate**2 + gravity_mps2 * np.sin(q)
    accel_y = -lever * rate**2 - side_offset * slope - gravity_mps2 * np.cos(q)
    made = [rate[..., None] * turn[2] + theta[2:5],
            accel_x[..., None] * turn[0] + accel_y[..., None] * turn[1] + theta[5:8]]
    return np.concatenate([windows.gyro, windows.accel], axis=2) - np.concatenate(made, axis=2)


def _referred(fit: _Fit, rests: Sequence[tuple[FloatArray, FloatArray]], noise: tuple[float, float], swing: float
              ) -> MountFit:
    """The fit with q = 0 where the link hung at rest, intervals carried over."""
    mean = np.mean([m for m, _ in rests], axis=0)
    halves = np.array([h for _, h in rests])
    factor = student_quantile(fit.freedom)
    spread = np.sqrt(np.mean(halves**2, axis=0) / len(rests)) / factor

    def quantities(x: FloatArray) -> FloatArray:
        """Angle at rest, lever, side_offset, of (theta, mean reading at rest)."""
        turn = Rotation.from_rotvec([x[0], x[1], 0.0]).as_matrix() @ fit.rows
        a_x, a_y = (turn @ (x[10:] - x[5:8]))[:2]
        rest = np.arctan2(a_x, -a_y)
        c, s = np.cos(rest), np.sin(rest)
        return np.array([rest, c * x[8] - s * x[9], s * x[8] + c * x[9]])

    x = np.concatenate([fit.theta, mean])
    covariance = np.zeros((13, 13))
    covariance[:10, :10], covariance[10:, 10:] = fit.covariance, np.diag(spread**2)
    by_x = np.array([(quantities(x + STEP * e) - quantities(x - STEP * e)) / (2 * STEP) for e in np.eye(13)]).T
    half = factor * np.sqrt(np.diag(by_x @ covariance @ by_x.T))
    rest, lever, side_offset = quantities(x)
    back = np.array([[np.cos(rest), np.sin(rest), 0.0], [-np.sin(rest), np.cos(rest), 0.0], [0.0, 0.0, 1.0]])
    mount = back @ Rotation.from_rotvec([fit.theta[0], fit.theta[1], 0.0]).as_matrix() @ fit.rows
    angles = np.array([fit.half[0], fit.half[1], half[0]])
    return MountFit(mount, angles, float(lever), float(half[1]), float(side_offset), float(half[2]), fit.theta[2:5],
                    fit.half[2:5], fit.theta[5:8], fit.half[5:8], noise, swing)
