"""What the IMU on link 1 and other orientation sensors show of the pivot's motion."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.signals.filters import central_difference, lowpass


def accelerometer(q1: FloatArray, q1d: FloatArray, q1dd: FloatArray, lever_arm: float,
                  gravity: float) -> tuple[FloatArray, FloatArray]:
    """(a_x, a_y) [m/s2]: a_x = l q1dd + g sin q1 (tangential), a_y = -l q1d^2 - g cos q1 (along the link).

    The true pair behind the paper's printed (63), which mixes two conventions.
    """
    return lever_arm * q1dd + gravity * np.sin(q1), -lever_arm * q1d**2 - gravity * np.cos(q1)


def tilt(accel_x: FloatArray, accel_y: FloatArray, gyro: FloatArray, rate_hz: float, lever_arm: float,
         cutoff_hz: float | None, order: int = 4) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(sin q1, cos q1, q1dd) from IMU samples (n,) by eq. (63) with its signs mended; inputs unfiltered.

    All three are low-passed alike; gravity is taken from the sensor's own mean norm, which cancels a
    common accelerometer gain.
    """
    x, y, rate = lowpass(np.stack([accel_x, accel_y, gyro], axis=1), cutoff_hz, rate_hz, order).T.copy()
    q1dd = central_difference(rate, 1.0 / rate_hz)
    s, c = x - lever_arm * q1dd, -y - lever_arm * rate**2
    norm = np.hypot(s, c)
    return s / norm, c / norm, q1dd


def fuse_tilt(accel_x: FloatArray, accel_y: FloatArray, gyro: FloatArray, rate_hz: float, lever_arm: float,
              cutoff_hz: float | None, crossover_hz: float = 0.3) -> FloatArray:
    """q1 (n,) [rad], unwrapped: the gyro's integral above `crossover_hz`, gravity's tilt below it.

    Zero phase, so it may start a smoother; it is not an estimate with an error bar.
    """
    s, c, _ = tilt(accel_x, accel_y, gyro, rate_hz, lever_arm, cutoff_hz)
    angle = np.unwrap(np.arctan2(s, c))
    rate = 0.5 * (gyro[1:] + gyro[:-1]) / rate_hz
    integral = np.concatenate(([0.0], np.cumsum(rate)))
    slow = angle - integral
    if slow.shape[0] < 6 * rate_hz / crossover_hz:
        trend = np.polynomial.Polynomial.fit(np.arange(slow.shape[0]), slow, 1)
        return integral + trend(np.arange(slow.shape[0]))
    return integral + lowpass(slow, crossover_hz, rate_hz, 2)
