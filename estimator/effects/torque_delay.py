"""`TorqueDelay`: a measured torque that is late."""

from __future__ import annotations

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.sensor_effects import TorqueSensorEffect
from estimator.signals import Channel, torque_of


class TorqueDelay(TorqueSensorEffect):
    """reading(t) = u(t - d).

    Of the reading only what is slow is moved in time: noise that falls between samples is averaged, and an estimate
    would be drawn to half a sample for it.
    """

    name = "torque_delay"
    sizes = (Size("delay", "s", 0.001, tolerance=5e-4),)
    sentence = "the measured torque is late against the torque that acted (early where the delay is negative)"
    reference = "dead time of a current loop; positive: the measurement is late"
    tolerance_source = "half a period of a current loop of 1 kHz"
    experiment = "motion at high frequency: phase grows with it"
    depends_on = "du"
    plans = ("fast",)

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        slow = view.measured.slow if view.measured is not None else {}
        return {torque_of(j): view.delayed(view.samples.u[j], slow.get(torque_of(j)), size[0])
                for j in self.driven(view)}
