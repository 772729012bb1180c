"""Clocks that disagree."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from daq import FloatArray
from estimator.effects.base import SensorEffect, Size, View
from estimator.model import Mechanism
from estimator.signals import Channel, Kind, imu_channels, imu_readings


def shifted(x: FloatArray, delay_s: float, view: View) -> FloatArray:
    """x(t - delay) at the samples (N,), cubic spline within each segment, its ends held."""
    from scipy.ndimage import shift

    out = np.empty_like(x)
    for where in view.segments():
        out[where] = shift(x[where], delay_s / view.dt_s, order=3, mode="nearest")
    return out


class SensorTimeSkew(SensorEffect):
    """reading(t) = y(t - d) for every channel y of the IMU."""

    name = "sensor_time_skew"
    sizes = (Size("skew", "s", 0.001),)
    sentence = "the IMU is late against encoder and torque"
    reference = "docs/theory.md, Clocks; positive: the IMU is late"
    experiment = "fast reversals of the pivot; a tap seen by both"
    depends_on = "a"
    plans = ("fast",)
    by_hand = "tap the leg once in one run"
    rough: ClassVar[Mapping[Kind, float]] = {"gyro": 1.6, "accel_x": 1.6, "accel_y": 1.6}
    """The record is interpolated between its samples, and misses what dry friction's reversals do there."""
    starts = ((0.02,), (-0.02,))

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        if view.measured is not None:  # x(t - d) - y(t) is x(t) - y(t + d), whose dependence on x is plain
            read = view.measured.readings
            channels = [c for k in range(len(view.mechanism.imus)) for c in imu_channels(k)]
            return {c: read[c] - shifted(read[c], -size[0], view) for c in channels}
        s = view.samples
        return {c: shifted(x, size[0], view) - x for c, x in imu_readings(view.mechanism, s.q, s.v, s.a).items()}

    def open_size(self, clock_bound_s: float) -> float:
        return clock_bound_s

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if has_imu else "no IMU on this path"
