"""Torque laws of effects at an instant of the motion, and their derivatives: what Newton's method needs of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from daq import FloatArray
from estimator.effects.base import Joined, LawEffect, Points, StateEffect, View
from estimator.model import ACCEL, ANGLE, GAUSS, RATE, RATE_FROM, RATE_TO, Motion, mean_sign, smooth_sign

STEPS = {"q": 1e-5, "v": 1e-5, "a": 1e-3, "sign": 1e-4, "state": 1e-4}
"""Of the central differences, by field of `Points`."""


def by_motion(effect: Joined, at: Points, size: FloatArray, view: View, joint: int | None = None,
              loops: bool = False) -> dict[str, FloatArray]:
    """Derivatives (...) of an effect's law by angle, rate, acceleration and smoothed sign of a `joint`, by default its
    own; with `loops` the torque of its loop moves, too."""
    j = (effect.joint or 0) if joint is None else joint
    return {name: _slope(effect, at, size, view, name, j, loops) for name in STEPS if name != "state"}


def _slope(effect: Joined, at: Points, size: FloatArray, view: View, name: str, joint: int | None = None,
           loops: bool = False) -> FloatArray:
    """Derivative (...) of the law by one array of `at`, at one joint where the array has joints."""
    h, driven = STEPS[name], in_loop if loops else lambda at: at
    up, down = (effect.law(driven(_moved(at, name, joint, by)), size, view) for by in (h, -h))
    return np.asarray((up - down) / (2.0 * h))


def in_loop(at: Points) -> Points:
    """`at` with the torque that position loops make there on top of its own."""
    return at if at.commanded is None else replace(at, u=at.u + loop_torque(at))


def loop_torque(at: Points) -> FloatArray:
    """(n, ...) torque of the position loops at the motion in `at`, whose further rows are bodies."""
    assert at.commanded is not None
    n = len(at.u)
    return at.commanded.input(at.q[:n], at.v[:n], at.a[:n])


def _moved(at: Points, name: str, joint: int | None, by: float) -> Points:
    """`at` with one array moved by `by`, at one joint where it has joints."""
    values = np.array(getattr(at, name))
    values[... if joint is None else joint] += by
    moved: dict[str, Any] = {name: values}
    return replace(at, **moved)


@dataclass(frozen=True)
class Laws:
    """Laws of some effects along a simulated motion, from one interval on."""

    pairs: Sequence[tuple[LawEffect, FloatArray]]
    view: View
    """At any motion: what does not change with it is taken from there."""
    first: int = 0
    """Interval of `view` that the simulation calls its first."""
    start: FloatArray | None = None
    """(N, S) states of the simulation's samples along a motion near it, if the pairs have any."""
    closed: bool = False
    """Whether position loops make the torque of their joints; the torque of the view acts on top of that."""

    @cached_property
    def states(self) -> FloatArray:
        """(N, S) states at the simulation's samples near its motion, the first of them exact."""
        return np.zeros((self.view.samples.q.shape[-1], 0)) if self.start is None else self.start

    def torque(self, motion: Motion, where: slice, z: FloatArray) -> FloatArray:
        """(n, 2, K) torque taken on the intervals `where`, with the states z (K + 1, S) at their ends."""
        at, out = self._points(motion, where), np.zeros_like(motion.angle)
        if self.closed:
            driving = loop_torque(at)
            out[: len(driving)] -= driving
            at = replace(at, u=at.u + driving)
        for part, size, state in self._parts(z):
            out[part.joint or 0] += part.law(_in_state(at, state), size, self.view)
        return out

    def slopes(self, motion: Motion, where: slice, z: FloatArray) -> FloatArray:
        """(n, 5, n, 2, K) its derivatives by the features of the motion."""
        at = self._points(motion, where)
        n = len(motion.angle)
        out = np.zeros((n, 5, n, *motion.angle.shape[1:]))
        if self.closed:
            self._loop_slopes(at, out)
        for part, size, state in self._parts(z):
            j = part.joint or 0
            for k in part.felt(n):
                found = by_motion(part, _in_state(at, state), size, self.view, k, self.closed)
                for name, feature in (("q", ANGLE), ("v", RATE), ("a", ACCEL)):
                    out[j, feature, k] += found[name]
                scale = self.view.mechanism.velocity_scales[k]
                _, by_from, by_to = mean_sign(motion.rate_from[k], motion.rate_to[k], scale)
                out[j, RATE_FROM, k] += found["sign"] * by_from
                out[j, RATE_TO, k] += found["sign"] * by_to
        return out

    @staticmethod
    def _loop_slopes(at: Points, out: FloatArray) -> None:
        """Add those of the position loops to `out` (n, 5, n, 2, K): each feels its own joint."""
        for name, feature in (("q", ANGLE), ("v", RATE), ("a", ACCEL)):
            h, j = STEPS[name], np.arange(len(at.u))
            up, down = (loop_torque(_moved(at, name, None, by)) for by in (h, -h))
            out[j, feature, j] -= (up - down) / (2.0 * h)

    def by_states(self, motion: Motion, where: slice, z: FloatArray) -> FloatArray:
        """(n, 2, S, K) derivatives of the torque by the states at the Gauss points."""
        at = self._points(motion, where)
        n, points, count = motion.angle.shape
        out = np.zeros((n, points, z.shape[1], count))
        for s, (effect, size) in enumerate(self.with_state):
            found = _slope(effect, _in_state(at, z[:, s]), size, self.view, "state", None, self.closed)
            out[effect.joint or 0, :, s] = found
        return out

    def gaps(self, v: FloatArray, z: FloatArray) -> FloatArray:
        """(S, K) what the states z (K + 1, S) miss of their recurrence along the rates v (K + 1, n)."""
        out = np.empty((z.shape[1], len(z) - 1))
        for s, (effect, size) in enumerate(self.with_state):
            decay, target = self._relaxation(effect, size, v[:-1], v[1:])
            out[s] = z[1:, s] - decay * z[:-1, s] - (1.0 - decay) * target
        return out

    def gap_slopes(self, v: FloatArray, z: FloatArray) -> FloatArray:
        """(S, 2, n + S, K) their derivatives by the rates and states at both ends of each interval."""
        n, count = v.shape[1], z.shape[1]
        out, h = np.zeros((count, 2, n + count, len(z) - 1)), STEPS["v"]
        for s, (effect, size) in enumerate(self.with_state):
            j = effect.joint or 0
            out[s, 0, n + s] = -self._relaxation(effect, size, v[:-1], v[1:])[0]
            out[s, 1, n + s] = 1.0
            for end in range(2):
                sides = []
                for by in (h, -h):
                    ends = [v[:-1].copy(), v[1:].copy()]
                    ends[end][:, j] += by
                    decay, target = self._relaxation(effect, size, *ends)
                    sides.append(-decay * z[:-1, s] - (1.0 - decay) * target)
                out[s, end, j] = (sides[0] - sides[1]) / (2.0 * h)
        return out

    def _relaxation(self, effect: StateEffect, size: FloatArray, before: FloatArray, after: FloatArray
                    ) -> tuple[FloatArray, FloatArray]:
        j, scale = effect.joint or 0, self.scale(effect)
        rates = before[:, j], after[:, j]
        return effect.relaxation(rates, (smooth_sign(rates[0], scale), smooth_sign(rates[1], scale)), size,
                                 self.view.dt_s)

    def scale(self, effect: LawEffect) -> float:
        """Smoothing velocity at its joint."""
        return float(self.view.mechanism.velocity_scales[effect.joint or 0])

    @property
    def with_state(self) -> list[tuple[StateEffect, FloatArray]]:
        """Those of the pairs that have a state, in the order of the states."""
        return [(e, size) for e, size in self.pairs if isinstance(e, StateEffect) and e.has_state]

    def _parts(self, z: FloatArray) -> Iterator[tuple[Joined, FloatArray, FloatArray | None]]:
        """Each part of each law with its sizes, and its state (K + 1,) where it has one."""
        column = 0
        for effect, size in self.pairs:
            for part in effect.parts:
                yield part, size, z[:, column] if effect.has_state else None
            column += effect.has_state

    def _points(self, motion: Motion, where: slice) -> Points:
        g = self.view.gauss
        cut = (..., slice(self.first + where.start, self.first + where.stop))
        sign = mean_sign(motion.rate_from, motion.rate_to, self.view.mechanism.velocity_scales[:, None, None])[0]
        told = None if g.commanded is None else g.commanded.cut(cut)
        return Points(motion.angle, motion.rate, motion.accel, g.u[cut], sign, g.time_s[cut], g.session_s[cut],
                      g.run[cut], np.asarray(g.exchanged)[cut] if np.ndim(g.exchanged) else g.exchanged,
                      commanded=told)


def _in_state(at: Points, z: FloatArray | None) -> Points:
    """`at` the Gauss points of intervals, with a state z (K + 1,) that is linear between their ends."""
    if z is None:
        return at
    return replace(at, state=np.stack([(1.0 - w) * z[:-1] + w * z[1:] for w in GAUSS]))
