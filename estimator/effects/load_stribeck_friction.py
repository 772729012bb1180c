"""`LoadStribeckFriction`: friction by load that is higher near standstill."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Points, Shape, Size, View
from estimator.effects.load_dependent_friction import ServoFriction, carried_load


class LoadStribeckFriction(ServoFriction):
    """mu |tau - F sign(v)| exp(-|v/vs|^n) sign(v): the part of friction by load that motion takes away."""

    name = "load_stribeck_friction"
    strict = True
    sizes = (Size("load_coefficient", "1", 0.01, tolerance=0.01),)
    shapes = (Shape("stribeck_velocity", "rad/s", (0.1, 0.4, 1.6), 1.5),
              Shape("exponent", "1", (1.0, 2.0), discrete=True, default=2.0))
    sentence = "friction by load is higher near standstill than in motion"
    reference = "load_friction_stribeck of Duclusaud, Passault, Padois, Ly 2025 (models M4 to M6)"
    tolerance_source = "gears with an efficiency of 98 to 99 % that start at 97 to 98 %"
    experiment = "slow reversals with a payload, and fast ones with the same"
    depends_on = "v"
    by_hand = ""

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j = self.joint or 0
        near_rest = np.exp(-(np.abs(at.v[j] / size[1]) ** size[2]))
        return np.asarray(size[0] * carried_load(at, j, view) * near_rest * at.sign[j])
