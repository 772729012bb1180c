"""`PreslidingFriction`: bristles that bend after a reversal (LuGre)."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Points, Shape, Size, StateEffect, View


class PreslidingFriction(StateEffect):
    """LuGre bristles in place of part of the sign: A (z - sign v) + B (v - |v| z), dz/ds = (sign v - z) / s0.

    The state z lags the sign of the velocity over a displacement s0 along the path s after a reversal. Bristles that
    bend also damp (B): while they do, not in steady sliding.
    """

    name = "presliding_friction"
    strict = True
    positive = 2  # bristles that drove would give back more than they took: a hysteresis that fades does
    defining = 1
    sizes = (Size("level", "N m", 0.01, tolerance=0.003), Size("bristle_damping", "N m s/rad", 0.005, tolerance=0.001))
    shapes = (Shape("displacement", "rad", (0.003, 0.01, 0.03, 0.1), below=1.0),)
    """Shorter is how a reversal falls between two samples."""
    sentence = "after a reversal friction builds up over a displacement, like a spring (presliding)"
    reference = "Dahl 1968; Canudas de Wit et al. 1995 (LuGre)"
    tolerance_source = "a few thousandths of the torque"
    experiment = "micro-motions: sines of a few milliradians about several angles"
    depends_on = "v"
    plans = ("micro", "slow")

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j = self.joint or 0
        return size[0] * (at.state - at.sign[j]) + size[1] * (at.v[j] - np.abs(at.v[j]) * at.state)

    def relaxation(self, v: tuple[FloatArray, FloatArray], sign: tuple[FloatArray, FloatArray], size: FloatArray,
                   dt_s: float) -> tuple[FloatArray, FloatArray]:
        """Exact over an interval of constant sign: e = exp(-|dq| / s0)."""
        return np.exp(-0.5 * np.abs(v[1] + v[0]) * dt_s / size[-1]), 0.5 * (sign[1] + sign[0])
