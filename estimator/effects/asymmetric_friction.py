"""`AsymmetricFriction`: friction that differs between both directions."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import CONSTANT, Points, Size, TorqueEffect, View


class AsymmetricFriction(TorqueEffect):
    """Extra Coulomb and viscous friction while v > 0: F max(s, 0) + B max(v, 0)."""

    name = "asymmetric_friction"
    equivalence_class = CONSTANT
    distinguishing_size = 1
    sizes = (Size("coulomb_difference", "N m", 0.01, tolerance=0.003),
             Size("viscous_difference", "N m s/rad", 0.01, tolerance=0.003))
    sentence = "friction differs between the two directions of motion"
    reference = "Janot, Gautier, Brunot 2019 (EMPS)"
    tolerance_source = "a few thousandths of the torque: bearings and brushes of small geared motors"
    experiment = "constant speed in both directions at several speeds, with rests between"
    depends_on = "v"
    plans = ("steady",)

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j = self.joint or 0
        forward = 0.5 * (1.0 + at.sign[j])
        return np.asarray(size[0] * forward + size[1] * forward * at.v[j])
