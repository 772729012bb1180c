"""Torque laws of effects at an instant of the motion, and their derivatives: what Newton's method needs of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from daq import FloatArray
from estimator.effects.base import Joined, LawEffect, Points, StateEffect, View
from estimator.effects.loop_effect import MOTION_STEPS, LoopEffect, central, moved_sides
from estimator.effects.state_torque import StateTorque
from estimator.model import ACCEL, ANGLE, GAUSS, RATE, RATE_FROM, RATE_TO, Motion, mean_sign, smooth_sign

STEPS = {**MOTION_STEPS, "sign": 1e-4, "state": 1e-4}
"""Of the central differences, by field of `Points`."""
FEATURES = {"q": ANGLE, "v": RATE, "a": ACCEL}


def by_motion(effect: Joined, around: Around, size: FloatArray, view: View, joint: int,
              state: FloatArray | None = None) -> dict[str, FloatArray]:
    """Derivatives (...) of an effect's law by the motion of a `joint`.

    They are by angle, rate, acceleration and, where it feels that, smoothed sign. `state` z (K + 1,) is that at the
    ends of the intervals.
    """
    if isinstance(effect, LoopEffect):
        return effect.slopes(around, size, view) if joint == (effect.joint or 0) else {}
    found = {}
    for name in (*FEATURES, "sign"):
        law = effect.moved_by(name, joint, around.loops) if isinstance(effect, StateTorque) else effect
        if isinstance(law, StateTorque) and not law.tables:
            continue
        up, down = (law.law(_in_state(at, state), size, view) for at in around.sides(name, joint))
        found[name] = np.asarray((up - down) / (2.0 * STEPS[name]))
    return found


def in_loop(at: Points) -> Points:
    """`at` with the torque that position loops make there on top of its own."""
    return at if at.commanded is None else replace(at, u=at.u + loop_torque(at))


def loop_torque(at: Points) -> FloatArray:
    """(n, ...) torque of the position loops at the motion in `at`, whose further rows are bodies."""
    assert at.commanded is not None
    n = len(at.u)
    return at.commanded.input(at.q[:n], at.v[:n], at.a[:n])


@dataclass(frozen=True)
class Around:
    """Points near `at`, for central differences of all laws there: what they have in common is made once."""

    at: Points
    loops: bool = False
    """Whether position loops make torque on top of that in `at`, which moves with the motion."""

    @cached_property
    def loop_slopes(self) -> dict[str, FloatArray]:
        """Derivatives (n, ...) of the torque of each loop by angle, rate and acceleration of its joint."""
        return central(self.loop_sides)

    @cached_property
    def loop_sides(self) -> FloatArray:
        """(6, n, ...) torque of the loops at `moved_sides` of their joints."""
        assert self.at.commanded is not None
        n = len(self.at.u)
        return self.at.commanded.input(*moved_sides(self.at.q[:n], self.at.v[:n], self.at.a[:n]))

    @cached_property
    def driving(self) -> FloatArray:
        """(n, ...) torque of the loops at `at`."""
        return loop_torque(self.at)

    def sides(self, name: str, joint: int) -> tuple[Points, Points]:
        """`at` with one array moved up and down at one joint."""
        key = name, joint
        if key not in self._kept:
            self._kept[key] = self._side(name, joint, 0), self._side(name, joint, 1)
        return self._kept[key]

    @cached_property
    def _kept(self) -> dict[tuple[str, int], tuple[Points, Points]]:
        return {}

    def _side(self, name: str, joint: int, which: int) -> Points:
        values = np.array(getattr(self.at, name))
        values[joint] += STEPS[name] * (1 - 2 * which)
        moved: dict[str, Any] = {name: values}
        if self.loops and self.at.commanded is not None:
            driving = self.driving
            if name in FEATURES and joint < len(driving):
                driving = driving.copy()
                driving[joint] = self.loop_sides[2 * list(FEATURES).index(name) + which, joint]
            moved["u"] = self.at.u + driving
        return replace(self.at, **moved)


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
        around = Around(self._points(motion, where), self.closed)
        n = len(motion.angle)
        out = np.zeros((n, 5, n, *motion.angle.shape[1:]))
        if self.closed:  # each loop feels its own joint
            every = np.arange(len(around.at.u))
            for name, slope in around.loop_slopes.items():
                out[every, FEATURES[name], every] -= slope
        for part, size, state in self._parts(z):
            j = part.joint or 0
            for k in part.felt(n):
                found = by_motion(part, around, size, self.view, k, state)
                sign = found.pop("sign", None)
                for name, slope in found.items():
                    out[j, FEATURES[name], k] += slope
                if sign is None:
                    continue
                scale = self.view.mechanism.velocity_scales[k]
                _, by_from, by_to = mean_sign(motion.rate_from[k], motion.rate_to[k], scale)
                out[j, RATE_FROM, k] += sign * by_from
                out[j, RATE_TO, k] += sign * by_to
        return out

    def by_states(self, motion: Motion, where: slice, z: FloatArray) -> FloatArray:
        """(n, 2, S, K) derivatives of the torque by the states at the Gauss points."""
        at = self._points(motion, where)
        n, points, count = motion.angle.shape
        out = np.zeros((n, points, z.shape[1], count))
        for s, (effect, size) in enumerate(self.with_state):
            here, h = _in_state(in_loop(at) if self.closed else at, z[:, s]), STEPS["state"]
            up, down = (effect.law(replace(here, state=here.state + by), size, self.view) for by in (h, -h))
            out[effect.joint or 0, :, s] = (up - down) / (2.0 * h)
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
        key = where.start, where.stop
        if key not in self._kept:
            self._kept[key] = self._cut((..., slice(self.first + where.start, self.first + where.stop)))
        sign = mean_sign(motion.rate_from, motion.rate_to, self.view.mechanism.velocity_scales[:, None, None])[0]
        return replace(self._kept[key], q=motion.angle, v=motion.rate, a=motion.accel, sign=sign)

    @cached_property
    def _kept(self) -> dict[tuple[int, int], Points]:
        """What does not change with the motion, by the first interval and that after the last."""
        return {}

    def _cut(self, cut: Any) -> Points:
        g = self.view.gauss
        return Points(g.q[cut], g.v[cut], g.a[cut], g.u[cut], g.sign[cut], g.time_s[cut], g.session_s[cut], g.run[cut],
                      np.asarray(g.exchanged)[cut] if np.ndim(g.exchanged) else g.exchanged,
                      commanded=None if g.commanded is None else g.commanded.cut(cut))


def _in_state(at: Points, z: FloatArray | None) -> Points:
    """`at` the Gauss points of intervals, with a state z (K + 1,) that is linear between their ends."""
    if z is None:
        return at
    return replace(at, state=np.stack([(1.0 - w) * z[:-1] + w * z[1:] for w in GAUSS]))
