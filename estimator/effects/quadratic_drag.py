"""`QuadraticDrag`: drag that grows with the square of the speed."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Points, Size, TorqueEffect, View


class QuadraticDrag(TorqueEffect):
    """c v |v|."""

    name = "quadratic_drag"
    positive = 1
    sizes = (Size("drag", "N m s^2/rad^2", 0.001, tolerance=0.001),)
    sentence = "drag grows with the square of the speed"
    reference = "effects of air and churning; quadratic drag law"
    tolerance_source = "air on links of a few decimetres"
    experiment = "a free swing from a large angle, or fast motion at two amplitudes"
    depends_on = "v"
    plans = ("swing",)

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        v = at.v[self.joint or 0]
        return size[0] * v * np.abs(v)
