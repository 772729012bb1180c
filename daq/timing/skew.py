"""Remaining time offset between the IMU and the encoders after both were put on the host's time line.

The pivot's Hall sensor and the gyro see the same motion. Integral of the gyro = Hall angle + constant + bias and drift
+ d * gyro, where d is the gyro's delay. A regression estimates d.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from daq.dataset import Dataset, FloatArray

FARTHEST_S = 0.1
LEAST_SAMPLES = 200
LEAST_SIGNAL = 3.0
"""Signal to noise of the correlation's peak below which nothing is said."""


class Skew(NamedTuple):
    """IMU late against the encoders, when positive."""

    seconds: float
    std_s: float
    """One sigma, from what the regression leaves."""


def measure_skew(run: Dataset) -> Skew | None:
    """Skew of a run with a gyro and a pivot angle; None where the motion does not show it."""
    if "gyro_radps" not in run or "q1_rad" not in run:
        return None
    here = _longest_whole(np.isfinite(run["gyro_radps"]) & np.isfinite(run["q1_rad"]))
    gyro, angle = run["gyro_radps"][here], run["q1_rad"][here]
    if gyro.size < LEAST_SAMPLES:
        return None
    step = 1.0 / run.rate_hz
    shift = _coarse(gyro, angle, step)
    for _ in range(3):
        found = _refine(gyro, angle, step, shift)
        if found is None:
            return None
        shift, std = found
    return Skew(shift, std) if abs(shift) < FARTHEST_S else None


def _longest_whole(good: np.ndarray) -> slice:
    """The longest segment of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], good.astype(int), [0]))))
    if not edges.size:
        return slice(0, 0)
    starts, stops = edges[::2], edges[1::2]
    k = int(np.argmax(stops - starts))
    return slice(int(starts[k]), int(stops[k]))


def _coarse(gyro: FloatArray, angle: FloatArray, step: float) -> float:
    """Whole steps by which the gyro is late: the peak of its correlation with the angle's slope."""
    slope = np.gradient(angle, step)
    a, b = gyro - gyro.mean(), slope - slope.mean()
    most = min(round(FARTHEST_S / step), gyro.size // 4)
    lags = np.arange(-most, most + 1)
    products = [float(np.dot(a[max(k, 0): a.size + min(k, 0)], b[max(-k, 0): b.size + min(-k, 0)])) for k in lags]
    return float(lags[int(np.argmax(products))]) * step


def _refine(gyro: FloatArray, angle: FloatArray, step: float, shift: float) -> tuple[float, float] | None:
    """Regression of angle - integral(gyro, shifted back) on 1, t, t^2, integral and gyro; None without a signal."""
    t = np.arange(gyro.size) * step
    integral = np.concatenate(([0.0], np.cumsum(0.5 * (gyro[1:] + gyro[:-1])) * step))
    inner = (t + shift >= 0) & (t + shift <= t[-1])
    total, rate = np.interp(t[inner] + shift, t, integral), np.interp(t[inner] + shift, t, gyro)
    span = t[-1]
    table = np.column_stack([np.ones(total.size), t[inner] / span, (t[inner] / span) ** 2, total, rate])
    left, q = angle[inner] - total, np.linalg.qr(table)
    solution = np.linalg.solve(q.R, q.Q.T @ left)
    residual = left - table @ solution
    inverse = np.linalg.inv(q.R)
    sigma2 = float(residual @ residual) / max(total.size - table.shape[1], 1)
    std = float(np.sqrt(sigma2 * (inverse @ inverse.T)[4, 4]))
    signal = float(np.std(rate)) * step
    if not np.isfinite(std) or signal == 0.0 or float(np.std(angle[inner])) < LEAST_SIGNAL * np.sqrt(sigma2):
        return None
    return shift + float(solution[4]), std
