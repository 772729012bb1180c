"""`AccelerometerBias`: an offset of both axes of the accelerometer."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.sensor_effects import ImuEffect
from estimator.signals import ACCEL_X, ACCEL_Y, Channel


class AccelerometerBias(ImuEffect):
    """reading = (a_x + b_x, a_y + b_y)."""

    name = "accelerometer_bias"
    sizes = (Size("bias_x", "m/s2", 0.01, tolerance=0.1), Size("bias_y", "m/s2", 0.01, tolerance=0.1))
    sentence = "the accelerometer has a bias"
    reference = "LSM9DS1 datasheet: zero-g level"
    tolerance_source = "after legid calibrate imu; the LSM9DS1's zero-g level alone is +-90 mg (data sheet)"
    experiment = "six positions at rest"
    plans = ("rest",)
    by_hand = "let legid calibrate see the IMU in six positions"

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        ones = np.ones(view.samples.q.shape[1])
        return {ACCEL_X: size[0] * ones, ACCEL_Y: size[1] * ones}
