"""`LoopEffect`: base of what a position loop does otherwise than its stated law."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from daq import FloatArray
from estimator.effects.base import Axis, Points, TorqueEffect, View
from estimator.effects.commanded import Commanded


class LoopEffect(TorqueEffect):
    """The torque by the stated law less the torque that acts, at a joint whose torque its loop's law gives."""

    per_loop = True
    depends_on: ClassVar[Axis] = "u"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j = self.joint or 0
        if at.commanded is None or not at.commanded.follows[j]:
            return np.zeros_like(at.q[j])
        own, told = slice(j, j + 1), at.commanded.of_joint(j)
        motion = at.q[own], at.v[own], at.a[own]
        return np.asarray((told.input(*motion) - self.acting(told, motion, size, view))[0])

    @abstractmethod
    def acting(self, told: Commanded, motion: tuple[FloatArray, FloatArray, FloatArray], size: FloatArray, view: View
               ) -> FloatArray:
        """(1, ...) torque of the loop [N m] at a motion q, v, a (1, ...) of its joint."""


def made(told: Commanded, error: FloatArray, rate_error: FloatArray, rate: FloatArray) -> FloatArray:
    """(n, ...) torque that the loops make of their errors."""
    loop = told.loop
    return loop.acting(loop.wanted(error, rate_error, told.summed), rate, told.supply)


def reach(told: Commanded, view: View, joint: int) -> FloatArray:
    """(n, ...) size of what a loop wants if the error is half of the `joint`'s range of angles, at most its limit."""
    half = 0.5 * float(np.ptp(view.angle_range[joint])) or 1.0
    return np.minimum(np.abs(np.asarray(told.loop.gain)) * half, told.loop.limit)
