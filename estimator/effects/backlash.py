"""`Backlash`: a gear with play."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Shape, Size
from estimator.effects.gear_effect import MOTOR, GearEffect


class Backlash(GearEffect):
    """reading = q + (gap / 2) tanh(T / T_c): the link lies at one side of the gap, by the torque T through it."""

    name = "backlash"
    positive = 1
    sizes = (Size("gap", "rad", 0.002, tolerance=0.001), *MOTOR)
    shapes = (Shape("contact_torque", "N m", (0.06, 0.1, 0.2), below=16.0),)
    sentence = "the gear has play: the link lies at one or the other side of a gap"
    reference = "Nordin and Gutman 2002"
    tolerance_source = "three arc minutes: play of a small planetary gear"
    experiment = "slow torque reversals across zero with the link held by gravity"
    depends_on = "u"
    plans = ("slow", "ramps")

    def relaxed(self, size: FloatArray, slack: float) -> FloatArray:
        """`size` with the slope of the twist reduced by up to `slack`, for a motion that starts far from its solution.
        """
        contact = abs(size[-1])
        return np.append(size[:-1], max(contact, min(slack * contact, max(self.shapes[0].grid))))

    def twist(self, through: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        side = np.tanh(through / size[-1])
        return 0.5 * size[0] * side, 0.5 * size[0] / size[-1] * (1.0 - side**2)
