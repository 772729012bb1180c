"""`RotorInertia`: the rotor behind the gear."""

from __future__ import annotations

from daq import FloatArray
from estimator.effects.base import Points, Size, TorqueEffect, View
from estimator.model import Mechanism


class RotorInertia(TorqueEffect):
    """J q2dd: the geared rotor, felt in its own joint's equation only."""

    name = "rotor_inertia"
    positive = 1
    sizes = (Size("inertia", "kg m^2", 0.001, tolerance=2e-4),)
    sentence = "the motor's rotor adds inertia at its joint (gear ratio squared)"
    reference = "Spong 1987"
    tolerance_source = "rotor of a small motor behind a gear of ten"
    experiment = "fast motion of the joint with the other one at large and small speed"
    depends_on = "a"
    plans = ("fast",)

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        return size[0] * at.a[self.joint or 0]

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        if any(p.term == "rotor" and p.at == (self.joint,) for p in mechanism.parameters):
            return "declared in the rig: it is a parameter of the nominal model"
        return "" if self.joint in actuated and mechanism.n > 1 else "no motor at this joint, or inertia absorbs it"
