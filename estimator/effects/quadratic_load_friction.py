"""`QuadraticLoadFriction`: friction that grows with the square of the transmitted torque."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Points, Size, View
from estimator.effects.load_dependent_friction import ServoFriction, carried_load


class QuadraticLoadFriction(ServoFriction):
    """k (tau - F sign(v))^2 sign(v)."""

    name = "quadratic_load_friction"
    sizes = (Size("load_coefficient", "1/(N m)", 0.01, tolerance=0.005),)
    sentence = "friction grows with the square of the torque that the joint transmits"
    reference = "load_friction_quad of Duclusaud, Passault, Padois, Ly 2025 (model M6), without its Stribeck part"
    tolerance_source = "half of what friction by load has, where the torque reaches 1 N m"
    experiment = "the same slow motion with two payloads and with none"
    depends_on = "u"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j = self.joint or 0
        return np.asarray(size[0] * carried_load(at, j, view) ** 2 * at.sign[j])
