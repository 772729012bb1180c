"""`ImuMisalignment`: an IMU that is turned against its link."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.sensor_effects import ImuEffect
from estimator.signals import ACCEL_X, ACCEL_Y, Channel, accelerometer_at


class ImuMisalignment(ImuEffect):
    """The IMU is turned by phi in the sense of q1: a_x' = a_x cos phi - a_y sin phi."""

    name = "imu_misalignment"
    sizes = (Size("angle", "rad", 0.005, tolerance=0.009),)
    sentence = "the IMU is mounted at an angle to the link"
    reference = "plane rotation"
    tolerance_source = "half a degree, set by eye"
    experiment = "rest hanging, and rest at a known angle"
    plans = ("rest",)
    by_hand = "hold the link at a known angle in one run"

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        at, m = view.samples, view.mechanism
        ax, ay = accelerometer_at(m, m.imus[0], at.q, at.v, at.a)
        c, s = np.cos(size[0]), np.sin(size[0])
        return {ACCEL_X: (c - 1.0) * ax - s * ay, ACCEL_Y: (c - 1.0) * ay + s * ax}
