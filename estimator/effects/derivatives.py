"""Torque laws of effects at an instant of the motion, and their derivatives: what Newton's method needs of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq import FloatArray
from estimator.effects.base import Effect, Joined, Points, View
from estimator.model import ACCEL, ANGLE, RATE, RATE_FROM, RATE_TO, Motion, mean_sign

STEPS = {"q": 1e-5, "v": 1e-5, "a": 1e-3, "sign": 1e-4}
"""Of the central differences, by field of `Points`."""


def by_motion(effect: Joined, at: Points, size: FloatArray, view: View) -> dict[str, FloatArray]:
    """Derivatives (...) of an effect's law by its own joint's angle, rate, acceleration and smoothed sign."""
    j = effect.joint or 0
    return {name: (effect.law(_moved(at, name, j, h), size, view)
                   - effect.law(_moved(at, name, j, -h), size, view)) / (2.0 * h) for name, h in STEPS.items()}


def _moved(at: Points, name: str, joint: int, by: float) -> Points:
    """`at` with one array moved by `by` at one joint."""
    values = getattr(at, name).copy()
    values[joint] += by
    return replace(at, **{name: values})


@dataclass(frozen=True)
class Laws:
    """Laws of some effects along a simulated motion, from one interval on."""

    pairs: Sequence[tuple[Effect, FloatArray]]
    view: View
    """At any motion: what does not change with it is taken from there."""
    first: int = 0
    """Interval of `view` that the simulation calls its first."""

    def torque(self, motion: Motion, where: slice) -> FloatArray:
        """(n, 2, K) torque taken on the intervals `where`."""
        at, out = self._points(motion, where), np.zeros_like(motion.angle)
        for part, size in self._parts():
            out[part.joint or 0] += part.law(at, size, self.view)
        return out

    def slopes(self, motion: Motion, where: slice) -> FloatArray:
        """(n, 5, n, 2, K) its derivatives by the features of the motion."""
        at = self._points(motion, where)
        n = len(motion.angle)
        out = np.zeros((n, 5, n, *motion.angle.shape[1:]))
        for part, size in self._parts():
            j = part.joint or 0
            found = by_motion(part, at, size, self.view)
            for name, feature in (("q", ANGLE), ("v", RATE), ("a", ACCEL)):
                out[j, feature, j] += found[name]
            scale = self.view.mechanism.velocity_scales[j]
            _, by_from, by_to = mean_sign(motion.rate_from[j], motion.rate_to[j], scale)
            out[j, RATE_FROM, j] += found["sign"] * by_from
            out[j, RATE_TO, j] += found["sign"] * by_to
        return out

    def _parts(self) -> Iterator[tuple[Joined, FloatArray]]:
        return ((part, size) for effect, size in self.pairs for part in effect.parts)

    def _points(self, motion: Motion, where: slice) -> Points:
        g = self.view.gauss
        cut = (..., slice(self.first + where.start, self.first + where.stop))
        sign = mean_sign(motion.rate_from, motion.rate_to, self.view.mechanism.velocity_scales[:, None, None])[0]
        return Points(motion.angle, motion.rate, motion.accel, g.u[cut], sign, g.time_s[cut], g.session_s[cut],
                      g.run[cut], np.asarray(g.exchanged)[cut] if np.ndim(g.exchanged) else g.exchanged)
