"""`LoopEffect`: base of what a position loop does otherwise than its stated law."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, Protocol

import numpy as np

from daq import FloatArray
from estimator.effects.base import Axis, Perturbation, Points, TorqueEffect, View
from estimator.effects.commanded import Commanded

MOTION_STEPS = {"q": 1e-5, "v": 1e-5, "a": 1e-3}
"""Of central differences by angle, rate and acceleration."""


Motion = tuple[FloatArray, FloatArray, FloatArray]
"""Angle, rate and acceleration."""


class Around(Protocol):
    """Points that slopes are taken around."""

    @property
    def at(self) -> Points:
        """The points."""


class LoopEffect(TorqueEffect):
    """The torque by the stated law less the torque that acts, at a joint whose torque its loop's law gives."""

    per_loop = True
    depends_on: ClassVar[Axis] = "u"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        j = self.joint or 0
        if at.commanded is None or not at.commanded.follows[j]:
            return np.zeros_like(at.q[j])
        own, told = slice(j, j + 1), at.commanded.of_joint(j)
        return self._lacking(told, (at.q[own], at.v[own], at.a[own]), size, view)[0]

    def slopes(self, around: Around, size: FloatArray, view: View) -> dict[str, FloatArray]:
        """Derivatives (...) of the law by angle, rate and acceleration of its joint; empty where nothing follows."""
        at, j = around.at, self.joint or 0
        if at.commanded is None or not at.commanded.follows[j]:
            return {}
        return central(self._lacking(at.commanded.of_joint(j), moved_sides(at.q[j], at.v[j], at.a[j]), size, view))

    def _lacking(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        return np.asarray(commanded.input(*motion) - self.acting(commanded, motion, size, view))

    @abstractmethod
    def acting(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        """(m, ...) torque of the loop [N m] at m motions q, v, a (m, ...) of its joint; `commanded` has (1, ...)."""


class ClosedLoop(LoopEffect):
    """The record's input of a joint less what its loop's law makes of the true motion.

    A record without a measured torque has the law's input by the angle that was read, whose error is that of the
    encoder times the gain: no noise of its own, which a fit could tell from the encoder's. It is no fault: without a
    sentence it is not in the library.
    """

    name = "closed_loop"
    sizes = ()
    reference: ClassVar[str] = "`daq.Loop`"
    experiment: ClassVar[str] = ""

    def __init__(self, joint: int, at_gauss: FloatArray, at_samples: FloatArray) -> None:
        super().__init__(joint)
        self.joint: int = joint
        self.recorded = at_gauss, at_samples
        """(2, K) and (N,) input by the record [N m]"""

    def perturb(self, view: View, size: FloatArray) -> Perturbation:
        perturbation = super().perturb(view, size)
        for torque, recorded in zip((perturbation.torque, perturbation.torque_at_samples), self.recorded):
            assert torque is not None
            torque[self.joint or 0] += recorded
        return perturbation

    def _lacking(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        return -commanded.input(*motion)

    def acting(self, commanded: Commanded, motion: Motion, size: FloatArray, view: View) -> FloatArray:
        return commanded.input(*motion)


def moved_sides(q: FloatArray, v: FloatArray, a: FloatArray) -> Motion:
    """A motion (...) six times (6, ...): with the angle up and down, then the rate, then the acceleration."""
    found = tuple(np.repeat(np.asarray(x)[None], 6, axis=0) for x in (q, v, a))
    for k, (x, h) in enumerate(zip(found, MOTION_STEPS.values())):
        x[2 * k] += h
        x[2 * k + 1] -= h
    return found[0], found[1], found[2]


def central(sides: FloatArray) -> dict[str, FloatArray]:
    """Derivatives (...) by angle, rate and acceleration of values (6, ...) at `moved_sides`."""
    return {name: (sides[2 * k] - sides[2 * k + 1]) / (2.0 * h) for k, (name, h) in enumerate(MOTION_STEPS.items())}


def made(commanded: Commanded, error: FloatArray, rate_error: FloatArray, rate: FloatArray) -> FloatArray:
    """(n, ...) torque that the loops make of their errors."""
    loop = commanded.loop
    return loop.acting(loop.wanted(error, rate_error, commanded.summed), rate, commanded.supply)


def reach(commanded: Commanded, view: View, joint: int) -> FloatArray:
    """(n, ...) size of what a loop wants if the error is half of the `joint`'s range of angles, at most its limit."""
    half = 0.5 * float(np.ptp(view.angle_range[joint])) or 1.0
    return np.minimum(np.abs(np.asarray(commanded.loop.gain)) * half, commanded.loop.limit)
