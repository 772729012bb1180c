"""`JointStiffness`: a spring at a joint."""

from __future__ import annotations

from daq import FloatArray
from estimator.effects.base import CONSTANT, Points, Size, TorqueEffect, View


class JointStiffness(TorqueEffect):
    """k q - c: a spring at the joint, c = k q0 its torque at the zero angle."""

    name = "joint_stiffness"
    equivalence_class = CONSTANT
    distinguishing_size = 0
    positive = 1
    sizes = (Size("stiffness", "N m/rad", 0.05, tolerance=0.01), Size("preload", "N m", 0.01, tolerance=0.005))
    sentence = "a spring acts at the joint (cable, seal, hose)"
    reference = "linear spring"
    tolerance_source = "cables and hoses along a joint"
    experiment = "static holds over the whole range of the joint"
    plans = ("ramps",)

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        return size[0] * at.q[self.joint or 0] - size[1]
