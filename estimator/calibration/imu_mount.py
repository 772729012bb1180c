"""Mounting of an IMU on a link that swings about a fixed axis: axes, place and offsets, from its own six readings.

The chip's readings are those of the link's axes x (tangential), y (away from the axis) and z (about which the gyro
reads the rate), turned by R, with r = l y + e x the way from the axis to the chip:

    gyro  = R^T (0, 0, qd) + b_g
    accel = R^T (l qdd - e qd^2 + g sin q, -l qd^2 - e qdd - g cos q, 0) + b_a

The rows of R are the link's axes in the chip's frame. Only gravity's size, not its direction, is known beforehand.
Where q = 0 is, a swing does not say: that is the pose in which the link hangs at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from daq import FloatArray
from estimator.calibration.spline_smoother import ITERATIONS, ROUNDS, PathFit, Sensor, Track, fit_path
from estimator.errors import FitError
from estimator.numerics import student_quantile

KNOT_S = 0.04
LEAST_SWING_RAD = 0.3
"""From end to end."""
THIN_HZ = 75.0
CLEAR = 25.0
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
    swing = max(float(np.ptp(_turned(s, axis))) for s in swings)
    if swing < LEAST_SWING_RAD:
        raise FitError(f"the link swung over {swing:.2f} rad, {LEAST_SWING_RAD} are needed: push it harder and record "
                       "again")
    thin = [_thinned(s) for s in swings]
    right, left = (_deviance(thin, down, axis, hand, gravity_mps2) for hand in (1.0, -1.0))
    best, rows = _fit(swings, down, axis, 1.0 if right <= left else -1.0, gravity_mps2)
    if abs(right - left) < CLEAR:
        raise FitError("the swings do not tell on which side the chip's axes lie: swing wider and for longer")
    return _referred(best, rows, rests, swing)


def _turned(s: Readings, axis: FloatArray) -> FloatArray:
    """(n,) angle by the gyro, about its mean; roughly, for its bias is taken for its mean."""
    rate: FloatArray = s.gyro_radps @ axis
    q = cumulative_trapezoid(rate - rate.mean(), s.time_s, initial=0)
    return np.asarray(q - q.mean(), dtype=np.float64)


def _thinned(s: Readings) -> Readings:
    """Some of the samples, none changed: enough to tell left from right."""
    rate = (s.time_s.size - 1) / float(s.time_s[-1] - s.time_s[0])
    every = max(int(rate / THIN_HZ), 1)
    return Readings(s.time_s[::every], s.gyro_radps[::every], s.accel_mps2[::every])


def _axis(swings: Sequence[Readings], hint: FloatArray) -> FloatArray:
    """Main direction of the gyro's readings, on the side of `hint`."""
    turning = np.vstack([s.gyro_radps - s.gyro_radps.mean(axis=0) for s in swings])
    axis = np.linalg.svd(turning[:: max(len(turning) // 20000, 1)], full_matrices=False)[2][0]
    return axis if axis @ hint >= 0 else -axis


def _deviance(swings: Sequence[Readings], down: FloatArray, axis: FloatArray, hand: float, gravity_mps2: float,
              ) -> float:
    """Residual of a quick fit; infinite where it does not converge, for instance with axes of the wrong handedness."""
    try:
        return _fit(swings, down, axis, hand, gravity_mps2, rounds=1, iterations=12)[0].deviance
    except FitError:
        return float("inf")


def _fit(swings: Sequence[Readings], down: FloatArray, axis: FloatArray, hand: float, gravity_mps2: float,
         rounds: int = ROUNDS, iterations: int = ITERATIONS) -> tuple[PathFit, FloatArray]:
    """(fit, rows of R before its tilt) for right-handed (+1) or left-handed (-1) axes."""
    y = down - (down @ axis) * axis
    if np.linalg.norm(y) < 0.5 * np.linalg.norm(down):
        raise FitError("gravity points along the axis of the swing: the rest record is of another pose, or the link "
                       "did not swing about a level axis")
    y /= np.linalg.norm(y)
    rows = np.array([hand * np.cross(y, axis), y, axis])
    sensor = Sensor(lambda theta, q, qd, qdd: readings(rows, theta, q, qd, qdd, gravity_mps2))
    tracks = []
    for s in swings:
        tracks.append(Track(s.time_s, [np.hstack([s.gyro_radps, s.accel_mps2])], _turned(s, axis)))
    start = np.zeros(PRIOR.size)
    start[2:5] = np.mean([s.gyro_radps.mean(axis=0) for s in swings], axis=0)
    return fit_path([sensor], tracks, start, PRIOR, KNOT_S, rounds, iterations), rows


def readings(rows: FloatArray, theta: FloatArray, q: FloatArray, qd: FloatArray, qdd: FloatArray,
             gravity_mps2: float) -> FloatArray:
    """(n, 6) gyro and accelerometer in the chip's axes; see the module's text."""
    turn = Rotation.from_rotvec([theta[0], theta[1], 0.0]).as_matrix() @ rows
    lever, side_offset = theta[8], theta[9]
    accel_x = lever * qdd - side_offset * qd**2 + gravity_mps2 * np.sin(q)
    accel_y = -lever * qd**2 - side_offset * qdd - gravity_mps2 * np.cos(q)
    gyro = qd[:, None] * turn[2] + theta[2:5]
    return np.hstack([gyro, accel_x[:, None] * turn[0] + accel_y[:, None] * turn[1] + theta[5:8]])


def _referred(fit: PathFit, rows: FloatArray, rests: Sequence[tuple[FloatArray, FloatArray]], swing: float) -> MountFit:
    """The fit with q = 0 where the link hung at rest, intervals carried over."""
    mean = np.mean([m for m, _ in rests], axis=0)
    halves = np.array([h for _, h in rests])
    factor = student_quantile(fit.freedom)
    spread = np.sqrt(np.mean(halves**2, axis=0) / len(rests)) / factor

    def quantities(x: FloatArray) -> FloatArray:
        """Angle at rest, lever, side_offset, of (theta, mean reading at rest)."""
        turn = Rotation.from_rotvec([x[0], x[1], 0.0]).as_matrix() @ rows
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
    mount = back @ Rotation.from_rotvec([fit.theta[0], fit.theta[1], 0.0]).as_matrix() @ rows
    angles = np.array([fit.half[0], fit.half[1], half[0]])
    noise = (float(np.sqrt(np.mean(fit.noise[0][:3] ** 2))), float(np.sqrt(np.mean(fit.noise[0][3:] ** 2))))
    return MountFit(mount, angles, float(lever), float(half[1]), float(side_offset), float(half[2]), fit.theta[2:5],
                    fit.half[2:5], fit.theta[5:8], fit.half[5:8], noise, swing)
