"""`JointElasticity`: a gear that twists under torque."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Size
from estimator.effects.gear_effect import MOTOR, GearEffect


class JointElasticity(GearEffect):
    """reading = q + T / k: the gear twists under the torque T through it."""

    name = "joint_elasticity"
    positive = 1
    sizes = (Size("compliance", "rad/(N m)", 0.002, tolerance=0.001), *MOTOR)
    sentence = "the gear twists under torque: the encoder on the motor does not show the link's angle"
    reference = "Spong 1987, quasi-static: below the motor's resonance"
    tolerance_source = "stiffness of small planetary gears, 1000 N m/rad"
    experiment = "a chirp up to the resonance; static torque steps against a blocked link"
    depends_on = "u"
    plans = ("fast",)
    by_hand = "add torque steps against a blocked link"

    def twist(self, through: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        return size[0] * through, np.full_like(through, size[0])
