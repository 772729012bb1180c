"""`ImuLeverArm`: a wrong distance of the IMU from its joint."""

from __future__ import annotations

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.sensor_effects import ImuEffect
from estimator.signals import ACCEL_X, ACCEL_Y, Channel, total


class ImuLeverArm(ImuEffect):
    """The IMU sits d further from its link's joint than declared: on link 1 d q1dd, -d q1d^2."""

    name = "imu_lever_arm"
    sizes = (Size("excess", "m", 0.002, tolerance=0.002),)
    sentence = "the IMU's distance from the pivot is not the declared one"
    reference = "rigid-body acceleration at the IMU, docs/theory.md, The sensors"
    tolerance_source = "a ruler, and the place of the sensor in its chip"
    experiment = "fast swings of the pivot"
    depends_on = "v"
    plans = ("fast", "swing")

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        joints = view.mechanism.joints_to(view.mechanism.imus[0].link)
        return {ACCEL_X: size[0] * total(view.samples.a, joints), ACCEL_Y: -size[0] * self.link_rate(view) ** 2}
