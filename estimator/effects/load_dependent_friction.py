"""`LoadDependentFriction`: friction that grows with the transmitted torque."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Points, Size, TorqueEffect, View
from estimator.model import Mechanism


def carried_load(at: Points, joint: int, view: View) -> FloatArray:
    """(...) size of the torque that a joint transmits [N m]: tau - F sign(v); with a voltage input the inverse dynamics
    of the links [V]."""
    m = view.mechanism
    if m.force_unit == "V":
        links = np.array([p.rigid for p in m.parameters])
        q, v, a = (np.moveaxis(x, 0, -1) for x in (at.q, at.v, at.a))
        return np.sqrt(m.inverse_dynamics(q, v, a, view.beta * links)[..., joint] ** 2 + 1e-6)
    return np.sqrt((at.u[joint] * at.sign[joint] - view.parameter("coulomb", joint)) ** 2 + 1e-6)


class LoadFriction(TorqueEffect):
    """Friction that grows with the torque that a joint transmits."""

    driven_only = "the joint carries no measured torque"
    positive = 1
    plans = ("steady", "ramps")
    by_hand = "record the session a second time with another payload"


class ServoFriction(LoadFriction):
    """A finer law of friction by load: that of a servo's gears, behind a position loop or a motor on voltage."""

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        driven = mechanism.actuated if mechanism.force_unit == "V" else mechanism.followers
        return "" if self.joint in driven else "no servo drives this joint"


class LoadDependentFriction(LoadFriction):
    """F = Fc + mu |tau - F sign(v)|: dry friction grows with the transmitted torque, tau less friction.

    So it is smaller while the motor drives than while it brakes. With a voltage input the load is the inverse dynamics
    of the links. A fit of a torque-driven leg does not converge with that.
    """

    name = "load_dependent_friction"
    strict = True
    sizes = (Size("load_coefficient", "1", 0.01, tolerance=0.01),)
    sentence = "friction grows with the torque that the joint transmits"
    reference = "Duclusaud, Passault, Padois, Ly 2025"
    tolerance_source = "gears with an efficiency of 98 to 99 %"
    experiment = "the same slow motion with two payloads, or under gravity at several angles"
    depends_on = "u"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j, m = self.joint or 0, view.mechanism
        if m.force_unit == "V":
            return size[0] * carried_load(at, j, view) * at.sign[j]
        over = at.u[j] * at.sign[j] - view.parameter("coulomb", j)
        load = np.sqrt(over**2 + 1e-6)
        return size[0] * load / (1.0 + np.clip(size[0], -0.9, 0.9) * over / load) * at.sign[j]
