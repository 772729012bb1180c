"""`EndStopContact`: a stop at the end of a joint's range."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Points, Shape, Size, TorqueEffect, View


class EndStopContact(TorqueEffect):
    """k max(q - q0, 0), smoothed: a one-sided spring beyond the angle q0; q0 < 0 is a stop on the other side."""

    name = "end_stop_contact"
    positive = 1
    sizes = (Size("stiffness", "N m/rad", 0.5, tolerance=0.005),)
    shapes = (Shape("angle_share", "1", (-0.9, -0.8, -0.65, 0.65, 0.8, 0.9), above=1.1, below=1.3),)
    strict = True
    """A stop that begins before half of the range is a hardening spring. One at its very end is never touched: there
    the smoothed law adds a constant torque."""
    sentence = "the joint touches a stop at the end of its range"
    reference = "Hunt and Crossley 1975 (linearised)"
    tolerance_source = "cables and seals that tighten at the end of the range"
    experiment = "slow approach to both ends of the range"
    plans = ("ramps",)
    by_hand = "approach the stops by hand: a plan keeps away from them"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j = self.joint or 0
        q = at.q[j]
        side = np.sign(size[1])
        reach = abs(view.angle_range[j, 1 if side > 0 else 0])
        depth = side * q - abs(size[1]) * reach
        smoothed = 0.5 * (depth + np.sqrt(depth * depth + 1e-6))
        return size[0] * side * smoothed
