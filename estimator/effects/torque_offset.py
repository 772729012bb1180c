"""`TorqueOffset`: an offset of the measured torque."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import CONSTANT, Size, View
from estimator.effects.sensor_effects import TorqueSensorEffect
from estimator.model import Mechanism
from estimator.signals import Channel, torque_of


class TorqueOffset(TorqueSensorEffect):
    """reading = u + c."""

    name = "torque_offset"
    per_motor = True
    equivalence_class = CONSTANT
    sizes = (Size("offset", "N m", 0.01, tolerance=0.005),)
    sentence = "the measured torque has an offset (shunt zero)"
    reference = "zero of the current shunt, [calibration] shunt_offset_a in README.md"
    tolerance_source = "a shunt's zero, half a per cent of its range"
    experiment = "rest with the motor off"
    depends_on = "v"
    plans = ("rest",)

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        return {torque_of(j): np.full(view.samples.q.shape[1], size[0]) for j in self.driven(view)}

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        if any(p.term == "offset" for p in mechanism.parameters):
            return "declared in the rig: it is a parameter of the nominal model"
        return super().testable(mechanism, has_imu, actuated)
