"""`CommandSteps`: a command that the servo rounds."""

from __future__ import annotations

import math

import numpy as np

from daq import FloatArray
from estimator.effects.base import Shape, Size, View
from estimator.effects.commanded import Commanded
from estimator.effects.loop_effect import LoopEffect, Motion, made

GRIDS = tuple(math.radians(step) for step in (360.0 / 4096.0, 360.0 / 1024.0, 0.29, 1.0, 2.0))
"""Steps of a command [rad]: 12 and 10 bits a turn, 0.29 degrees of the AX series, whole degrees and pairs of them."""


class CommandSteps(LoopEffect):
    """The loop follows c + s (round(c / w) w - c): the share s is 1 where it is there."""

    name = "command_steps"
    positive = 1
    sizes = (Size("share", "1", 0.1),)
    shapes = (Shape("step", "rad", GRIDS, discrete=True),)
    sentence = "the servo rounds its command to coarse steps"
    reference = "goal position of a servo's memory table, in counts"
    experiment = "slow ramps of the command"
    plans = ("slow", "ramps")

    def acting(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        error, rate_error = commanded.error(*motion)
        angle = commanded.heard[0]
        return made(commanded, error + size[0] * (np.round(angle / size[1]) * size[1] - angle), rate_error, motion[1])
