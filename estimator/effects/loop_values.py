"""Values of a loop's law that a fit estimates, or has a tolerance for, where the rig file does not state them."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from daq import FloatArray
from estimator.effects.base import Size, View
from estimator.effects.commanded import Commanded
from estimator.effects.loop_effect import LoopEffect, Motion, made


class _LoopValue(LoopEffect):
    """No fault: without a sentence it is not in the library."""

    reference: ClassVar[str] = "`daq.Loop`"
    experiment: ClassVar[str] = "state it under [servo]"


class LimitValue(_LoopValue):
    """The loop gives at most l, whatever limit is stated."""

    name = "loop_limit"
    sizes = (Size("limit", "N m", 0.02),)

    def acting(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        own = replace(commanded, loop=replace(commanded.loop, limit=max(float(size[0]), 0.0)))
        return made(own, *commanded.error(*motion), motion[1])


class DampingValue(_LoopValue):
    """The loop damps by d more than is stated."""

    name = "loop_damping"
    sizes = (Size("damping", "N m s/rad", 0.01),)

    def acting(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        own = replace(commanded, loop=replace(commanded.loop, damping=commanded.loop.damping + float(size[0])))
        return made(own, *commanded.error(*motion), motion[1])


class VelocityFilter(_LoopValue):
    """The damping has a rate that is behind a filter of T more than is stated: damping T q'' of torque, as an inertia.
    """

    name = "velocity_filter"
    sizes = (Size("time_constant", "s", 0.001),)

    def acting(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        error, rate_error = commanded.error(*motion)
        return made(commanded, error, rate_error + float(size[0]) * motion[2], motion[1])
