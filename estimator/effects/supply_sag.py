"""`SupplySag`: a supply that falls with the load."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.commanded import Commanded
from estimator.effects.loop_effect import LoopEffect, Motion, reach


class SupplySag(LoopEffect):
    """V (1 - s |w| / r): the supply has lost the share s where the loop wants r, its limit or half the range's error.

    A column of the supply (`supply_v`, `volts`) has it measured. `torque_saturation` falls short by the cube of the
    torque, a sag by its square.
    """

    name = "supply_sag"
    positive = 1
    sizes = (Size("lost_share", "1", 0.02, tolerance=0.02),)
    sentence = "the supply's voltage falls under load, so the motor gives less"
    reference = "a supply with a series resistance"
    tolerance_source = "cables and a battery of a few tenths of an ohm"
    experiment = "the same commands at two amplitudes, with the supply's voltage logged"
    plans = ("large",)

    def acting(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        error, rate_error = commanded.error(*motion)
        wanted = commanded.loop.wanted(error, rate_error, commanded.summed)
        left = np.maximum(1.0 - size[0] * np.abs(wanted) / reach(commanded, view, self.joint or 0), 0.1)
        return commanded.loop.acting(wanted, motion[1], commanded.supply * left)
