"""`SensorTimeSkew`: an IMU that is late."""

from __future__ import annotations

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.sensor_effects import ImuEffect
from estimator.signals import Channel, imu_readings


class SensorTimeSkew(ImuEffect):
    """reading(t) = y(t - d) for every channel y of the IMU."""

    name = "sensor_time_skew"
    sizes = (Size("skew", "s", 0.001, tolerance=3e-4),)
    sentence = "the IMU is late against encoder and torque"
    reference = "docs/theory.md, Clocks; positive: the IMU is late"
    tolerance_source = "clocks put together by messages on a USB or CAN bus"
    experiment = "fast reversals of the pivot; a tap seen by both"
    depends_on = "a"
    plans = ("fast",)
    by_hand = "tap the leg once in one run"
    starts = ((0.02,), (-0.02,))

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        s, recorded = view.samples, view.measured.readings if view.measured is not None else {}
        return {c: view.delayed(x, recorded.get(c), size[0])
                for c, x in imu_readings(view.mechanism, s.q, s.v, s.a).items()}
