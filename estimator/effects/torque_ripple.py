"""`TorqueRipple`: torque that ripples with the motor's angle."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Points, Shape, Size, TorqueEffect, View


class TorqueRipple(TorqueEffect):
    """A sin(n phi) + B cos(n phi), phi the motor's angle: gear ratio times the joint's."""

    name = "torque_ripple"
    driven_only = "no motor at this joint"
    sizes = (Size("sine_amplitude", "N m", 0.01, tolerance=0.003),
             Size("cosine_amplitude", "N m", 0.01, tolerance=0.003))
    shapes = (Shape("order", "1", (1.0, 2.0, 3.0, 4.0, 6.0, 7.0, 8.0, 12.0, 14.0), discrete=True),)
    sentence = "the motor's torque ripples with its angle (cogging, commutation)"
    reference = "whole orders of the motor's angle"
    tolerance_source = "cogging of small brushless motors"
    experiment = "slow constant speed over several turns of the motor"
    depends_on = "turn"
    plans = ("steady",)

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        phase = size[2] * view.gear_ratio * at.q[self.joint or 0]
        return -(size[0] * np.sin(phase) + size[1] * np.cos(phase))
