"""`GainScale`: gains that differ from those stated."""

from __future__ import annotations

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.commanded import Commanded
from estimator.effects.loop_effect import LoopEffect, Motion

LEAST = 0.1
"""Share of the gains."""


class GainScale(LoopEffect):
    """All gains of the loop are (1 + s) times those stated, its limits are not.

    Below the limits it is the scale of the torque, `torque_gain`: all parameters scale alike. One that is given
    (`--fix`), or a limit that is reached, shows it.
    """

    name = "gain_scale"
    sizes = (Size("scale_error", "1", 0.01),)
    sentence = "the loop's gains are not the ones stated (a vendor's unit or a hidden factor)"
    reference = "Dynamixel e-manual: register over 128; vendors' firmware scales gains"
    experiment = "give one parameter with --fix, or hold a known weight still and read the error of the command"
    by_hand = "hang a known weight on the joint and read the error of the command at rest"
    plans = ("rest",)

    def possible(self, size: FloatArray) -> bool:
        """Whether a tenth of the gains is left: with none, all parameters and the noise would be zero, too, which the
        likelihood takes for the best of fits."""
        return bool(size[0] > LEAST - 1.0)

    def acting(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        loop, more = commanded.loop, 1.0 + float(size[0])
        error, rate_error = commanded.error(*motion)
        return loop.acting(loop.wanted(more * error, more * rate_error, more * commanded.summed), motion[1],
                           commanded.supply)
