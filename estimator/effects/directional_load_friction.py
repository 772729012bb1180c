"""`DirectionalLoadFriction`: friction by the motor's and by the load's torque, each with its own share."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from daq import FloatArray
from estimator.effects.base import Points, Shape, Size, View
from estimator.effects.load_dependent_friction import ServoFriction


class DirectionalLoadFriction(ServoFriction):
    """(k + ks exp(-(v/vs)^2)) |(1 - s) tau_m - s tau_e| sign(v).

    tau_m is the torque of the motor. With a voltage input it is the voltage less the viscous term, which is nearly all
    back-EMF. tau_e is the torque of the load: minus gravity and velocity terms of the links. The coefficients of BAM's
    model M5 are k (1 - s) and k s in motion, more by ks (1 - s) and ks s near standstill; M5 has a share of its own
    for these.
    """

    name = "directional_load_friction"
    defining = 1
    sizes = (Size("load_coefficient", "1", 0.01, tolerance=0.01), Size("coefficient_near_rest", "1", 0.01))
    shapes = (Shape("load_share", "1", (0.1, 0.4, 0.8), 1.25, 100.0),
              Shape("stribeck_velocity", "rad/s", (0.3, 1.0), discrete=True, default=0.3))
    sentence = "friction grows with the torques of the motor and of the load, with different shares"
    reference = "load_friction_motor and load_friction_external of Duclusaud, Passault, Padois, Ly 2025 (M5, M6)"
    tolerance_source = "gears with an efficiency of 98 to 99 %"
    experiment = "lift a payload slowly and let it sink: the motor drives the gear, then the payload does"
    depends_on = "u"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j, m = self.joint or 0, view.mechanism
        motor = at.u[j] - (view.parameter("viscous", j) * at.v[j] if m.force_unit == "V" else 0.0)
        against_load = m.load_of_links(j, at.q[: m.n], at.v[: m.n], view.beta)  # without bodies on top
        transmitted = np.sqrt(((1.0 - size[2]) * motor + size[2] * against_load) ** 2 + 1e-6)
        near_rest = np.exp(-((at.v[j] / size[3]) ** 2))
        return np.asarray((size[0] + size[1] * near_rest) * transmitted * at.sign[j])

    def felt(self, count: int) -> Iterable[int]:
        return range(count)
