"""`CommandDeadBand`: a loop that leaves small errors alone."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.commanded import Commanded
from estimator.effects.loop_effect import LoopEffect, Motion, made


class CommandDeadBand(LoopEffect):
    """e less w e / (|e|^p + w^p)^(1/p), p = 6: an error below w makes hardly any torque, a larger one falls short by w.
    """

    name = "command_dead_band"
    positive = 1
    sizes = (Size("width", "rad", 2e-4, tolerance=5e-4),)
    sentence = "the loop makes no torque of small errors (dead band)"
    reference = "compliance margin of AX servos; CW and CCW dead zone of the Feetech STS memory table"
    tolerance_source = "a third of a step of an encoder of 4096 counts"
    experiment = "slow ramps of the command in both directions"
    plans = ("slow", "ramps")

    def acting(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        error, rate_error = commanded.error(*motion)
        width = float(size[0])
        most = np.maximum(np.maximum(np.abs(error), abs(width)), 1e-12)  # so that no power is too small a number
        left = width * error / (most * ((error / most) ** 6 + (width / most) ** 6) ** (1.0 / 6.0))
        return made(commanded, error - left, rate_error, motion[1])
