"""`StribeckFriction`: friction that is higher near standstill."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Points, Shape, Size, TorqueEffect, View


class StribeckFriction(TorqueEffect):
    """F exp(-|v/vs|^n) sign(v), n = 2 (Gaussian) for most lubricated contacts, 0.5 to 1 for slower decays."""

    name = "stribeck_friction"
    strict = True
    positive = 1
    sizes = (Size("excess_torque", "N m", 0.01, tolerance=0.005),)
    shapes = (Shape("stribeck_velocity", "rad/s", (0.1, 0.2, 0.4, 0.8), 1.25),
              Shape("exponent", "1", (0.5, 1.0, 2.0), discrete=True, default=2.0))
    """Slower than this grid is the smoothing of sign(v), faster is not near standstill."""
    sentence = "friction is higher near standstill than in motion (Stribeck)"
    reference = "Stribeck 1902; Armstrong-Helouvry 1991"
    tolerance_source = "a few thousandths of the torque"
    experiment = "slow reversals: a multisine below 0.3 Hz at small amplitude"
    depends_on = "v"
    plans = ("slow", "steady")

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j = self.joint or 0
        return size[0] * np.exp(-(np.abs(at.v[j] / size[1]) ** size[2])) * at.sign[j]

    def level_at_rest(self, size: FloatArray) -> float:
        """Dry friction that it adds to its joint's Coulomb level near rest [N m]."""
        return float(size[0])
