"""`GyroScale`: a wrong scale of the gyro."""

from __future__ import annotations

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.sensor_effects import ImuEffect
from estimator.signals import GYRO, Channel


class GyroScale(ImuEffect):
    """reading = (1 + s) q1d."""

    name = "gyro_scale"
    sizes = (Size("scale_error", "1", 0.01, tolerance=0.01),)
    sentence = "the gyro's scale is wrong"
    reference = "LSM9DS1 datasheet: sensitivity"
    tolerance_source = "sensitivity of uncalibrated MEMS gyros, such as the LSM9DS1"
    experiment = "large swings between two known rests"
    depends_on = "v"
    plans = ("rest",)

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        return {GYRO: size[0] * self.link_rate(view)}
