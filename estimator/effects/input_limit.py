"""`InputLimit`: a loop that gives no more than so much."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Shape, Size, View
from estimator.effects.commanded import Commanded
from estimator.effects.loop_effect import LoopEffect, Motion, reach


class InputLimit(LoopEffect):
    """w - c (w - clip(w, +-l)): of w beyond the level l the loop loses the share c, 1 at a hard limit.

    The level is a share of what it wants if the error is half of the joint's range. `torque_saturation` is the limit
    that is approached slowly.
    """

    name = "input_limit"
    positive = 1
    sizes = (Size("cut", "1", 0.1),)
    shapes = (Shape("level_share", "1", (0.05, 0.1, 0.2, 0.4, 0.8), below=4.0, above=2.0),)
    sentence = "the loop reaches a limit of torque, current or duty that is not stated"
    reference = "PWM, current and torque limits of servos' memory tables"
    experiment = "the same commands at two amplitudes"
    plans = ("large", "fast")
    starts = ((1.0, 0.1), (1.0, 0.3))

    def acting(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        loop = commanded.loop
        wanted = loop.wanted(*commanded.error(*motion), commanded.summed)
        level = size[1] * reach(commanded, view, self.joint or 0)
        return loop.acting(wanted - size[0] * (wanted - np.clip(wanted, -level, level)), motion[1], commanded.supply)
