"""`CommandDelay`: a command that acts later than it was logged."""

from __future__ import annotations

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.commanded import Commanded
from estimator.effects.loop_effect import LoopEffect, Motion, made


class CommandDelay(LoopEffect):
    """The loop follows c(t - d), d on top of the delay that is stated."""

    name = "command_delay"
    sizes = (Size("delay", "s", 0.001, tolerance=1e-3),)
    sentence = "a command acts later than it was logged (earlier where the delay is negative)"
    reference = "transport over a serial bus and the controller's period; BAM has it as command_delay"
    tolerance_source = "one round trip on a bus of 1 Mbit/s"
    experiment = "fast commands: phase grows with frequency"
    depends_on = "v"
    plans = ("fast",)
    starts = ((0.02,),)

    def told(self, size: FloatArray) -> str:
        """Sentence that says by how much, and on which side."""
        late_ms = 1e3 * abs(float(size[0]))
        return f"a command acts {late_ms:.3g} ms {'after' if size[0] > 0.0 else 'before'} it was logged"

    def acting(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        return made(commanded, *commanded.error(*motion, late_s=float(size[0])), motion[1])
