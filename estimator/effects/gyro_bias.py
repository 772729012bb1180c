"""`GyroBias`: an offset of the gyro."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.sensor_effects import ImuEffect
from estimator.signals import GYRO, Channel


class GyroBias(ImuEffect):
    """reading = q1d + b."""

    name = "gyro_bias"
    sizes = (Size("bias", "rad/s", 0.001, tolerance=0.002),)
    sentence = "the gyro has a bias"
    reference = "LSM9DS1 datasheet: zero-rate level"
    tolerance_source = "after the mean at rest is taken off; the LSM9DS1's zero-rate level is +-30 deg/s (data sheet)"
    experiment = "rest for a minute"
    depends_on = "v"
    plans = ("rest",)

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        return {GYRO: np.full(view.samples.q.shape[1], size[0])}
