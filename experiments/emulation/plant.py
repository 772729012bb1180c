"""`LegPlant`: physics of the emulated leg, body by body after Newton and Euler, from masses and lengths.

It shares no code with the estimator: no beta, no regressor and no smoothed sign. Each link is a
rigid body with mass, centre of mass and inertia; the knee's constraint force joins them; dry friction sticks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, cos, sin
from typing import NamedTuple

MAX_STEP_S = 5e-4
_RELEASE_TOLERANCE = 1e-12


@dataclass(frozen=True)
class LegBody:
    """Physical parameters of a 2-link leg [SI]; (pivot, knee) pairs for friction."""

    m1: float = 1.20
    """Mass of link 1 [kg], and so on."""
    l1: float = 0.30
    """Pivot to knee [m]."""
    c1: float = 0.17
    """Pivot to link 1's centre of mass [m]."""
    i1: float = 0.011
    """Inertia of link 1 about its centre of mass [kg m^2]."""
    m2: float = 0.75
    c2: float = 0.14
    """Knee to link 2's centre of mass [m]."""
    i2: float = 0.0065
    viscous: tuple[float, float] = (0.020, 0.030)
    """[N m s/rad]"""
    coulomb: tuple[float, float] = (0.025, 0.040)
    """[N m]; holds the joint still up to this torque, and acts against the motion beyond."""
    forward_coulomb: tuple[float, float] = (0.0, 0.0)
    """More dry friction while the joint's angle grows [N m]."""
    stribeck: tuple[float, float] = (0.0, 0.0)
    """Dry friction at standstill above that in motion [N m]: falls off as 1 / (1 + (v / vs)^2)."""
    stribeck_radps: float = 0.2
    """vs"""
    rotor: float = 0.0
    """Inertia of the knee's rotor, seen at the joint: gear ratio squared [kg m^2]. Turns with the knee only."""
    gravity: float = 9.81

    def friction(self, joint: int, direction: int, speed: float) -> float:
        """Level of dry friction [N m] of a joint that slides (or is about to) in a direction, +1 or -1."""
        level = self.coulomb[joint]
        if direction > 0:
            level += self.forward_coulomb[joint]
        if self.stribeck[joint]:
            level += self.stribeck[joint] / (1.0 + (speed / self.stribeck_radps) ** 2)
        return level

    def beta(self) -> tuple[float, ...]:
        """beta1..beta9 of docs/formats.md from the physical parameters."""
        return (self.i1 + self.m1 * self.c1**2 + self.m2 * self.l1**2, self.i2 + self.m2 * self.c2**2,
                self.m2 * self.l1 * self.c2, self.m1 * self.c1 + self.m2 * self.l1, self.m2 * self.c2,
                *self.viscous, *self.coulomb)


class LegState(NamedTuple):
    """Motion at one instant; angles by docs/formats.md [rad], rates [rad/s], accelerations [rad/s2]."""

    q1: float
    q2: float
    q1d: float
    q2d: float
    q1dd: float
    q2dd: float


Motion = tuple[float, float, float, float]
"""q1, q2, q1d, q2d."""
HiddenTorque = Callable[[float, Motion, float], tuple[float, float]]
"""An effect the nominal model does not know: (time [s], motion, knee torque) -> torques added (pivot, knee) [N m]."""


class LegPlant:
    """The leg as `drivers.mock` steps it. Runge-Kutta 4; a joint that comes to rest is caught at the crossing."""

    def __init__(self, body: LegBody | None = None, q: tuple[float, float] = (0.0, 0.0),
                 qd: tuple[float, float] = (0.0, 0.0), hidden: Sequence[HiddenTorque] = ()) -> None:
        self.body = body or LegBody()
        self.hidden = list(hidden)
        self.time_s = 0.0
        self._dry = [any(self.body.friction(j, way, 0.0) for way in (1, -1)) for j in (0, 1)]
        self._x: Motion = (*q, *qd)
        self._torque = 0.0

    @property
    def state(self) -> LegState:
        """Motion now, under the torque of the last step."""
        modes = self._modes(self._x, self._torque)
        return LegState(*self._x, *self._acceleration(self._x, self._torque, modes))

    def step(self, dt: float, torque: float) -> LegState:
        """Motion after `dt` seconds of a constant knee torque [N m]."""
        self._torque = torque = float(torque)
        parts = max(1, ceil(dt / MAX_STEP_S - 1e-9))
        for _ in range(parts):
            self._part(dt / parts, torque)
        return self.state

    def _part(self, h: float, torque: float) -> None:
        # Each pass ends at the end of the step or where a sliding joint first comes to rest: at most two
        # joints can do so, the third pass is for one that starts again.
        for _ in range(4):
            modes = self._modes(self._x, torque)
            x = self._runge_kutta(h, torque, modes)
            fraction, joint = 1.0, -1
            for j in (0, 1):
                before, after = self._x[2 + j], x[2 + j]
                if self._dry[j] and after * modes[j] < 0.0 < before * modes[j]:
                    f = before / (before - after)
                    if f < fraction:
                        fraction, joint = f, j
            if joint < 0:
                self._x = x
                self.time_s += h
                return
            x = self._runge_kutta(h * fraction, torque, modes)
            self._x = (x[0], x[1], 0.0, x[3]) if joint == 0 else (x[0], x[1], x[2], 0.0)
            self.time_s += h * fraction
            h *= 1.0 - fraction
        self._x = self._runge_kutta(h, torque, self._modes(self._x, torque))
        self.time_s += h

    def _runge_kutta(self, h: float, torque: float, modes: tuple[int, int]) -> Motion:
        q1, q2, v1, v2 = self._x
        a1, a2 = self._acceleration(self._x, torque, modes)
        u1, u2 = v1 + 0.5 * h * a1, v2 + 0.5 * h * a2
        b1, b2 = self._acceleration((q1 + 0.5 * h * v1, q2 + 0.5 * h * v2, u1, u2), torque, modes)
        w1, w2 = v1 + 0.5 * h * b1, v2 + 0.5 * h * b2
        c1, c2 = self._acceleration((q1 + 0.5 * h * u1, q2 + 0.5 * h * u2, w1, w2), torque, modes)
        s1, s2 = v1 + h * c1, v2 + h * c2
        d1, d2 = self._acceleration((q1 + h * w1, q2 + h * w2, s1, s2), torque, modes)
        return (q1 + h / 6.0 * (v1 + 2.0 * (u1 + w1) + s1), q2 + h / 6.0 * (v2 + 2.0 * (u2 + w2) + s2),
                v1 + h / 6.0 * (a1 + 2.0 * (b1 + c1) + d1), v2 + h / 6.0 * (a2 + 2.0 * (b2 + c2) + d2))

    def _modes(self, x: Motion, torque: float) -> tuple[int, int]:
        """Direction in which each joint slides: +1, -1, or 0 where friction holds it."""
        moving = [(v > 0.0) - (v < 0.0) for v in x[2:]]
        if all(moving):
            return moving[0], moving[1]
        resting = [j for j in (0, 1) if moving[j] == 0]
        for _ in range(2):
            held = [j for j in resting if moving[j] == 0]
            holding = self._holding(x, torque, (moving[0], moving[1]))
            # what friction would have to hold against pushes the other way
            excess = [(abs(holding[j]) - self.body.friction(j, -1 if holding[j] > 0.0 else 1, 0.0), j) for j in held]
            worst, j = max(excess, default=(0.0, 0))
            if worst <= _RELEASE_TOLERANCE:
                break
            moving[j] = -1 if holding[j] > 0.0 else 1
        return moving[0], moving[1]

    def _holding(self, x: Motion, torque: float, modes: tuple[int, int]) -> tuple[float, float]:
        """Friction torque that keeps each held joint at rest, 0 for a sliding one."""
        m11, m12, m22, n1, n2 = self._balance(x, torque, modes)
        if modes[0] == 0 and modes[1] == 0:
            return -n1, -n2
        if modes[0] == 0:
            return m12 * n2 / m22 - n1, 0.0
        if modes[1] == 0:
            return 0.0, m12 * n1 / m11 - n2
        return 0.0, 0.0

    def _acceleration(self, x: Motion, torque: float, modes: tuple[int, int]) -> tuple[float, float]:
        m11, m12, m22, n1, n2 = self._balance(x, torque, modes)
        if modes[0] == 0:
            return 0.0, (n2 / m22 if modes[1] else 0.0)
        if modes[1] == 0:
            return n1 / m11, 0.0
        determinant = m11 * m22 - m12 * m12
        return (m22 * n1 - m12 * n2) / determinant, (m11 * n2 - m12 * n1) / determinant

    def _balance(self, x: Motion, torque: float, modes: tuple[int, int]) -> tuple[float, float, float, float, float]:
        """Moment balances as m11, m12, m22 and the driving moments n1, n2 of  m (q1dd, q2dd) = n.

        Newton for each centre of mass and Euler for each body about it, in a frame x forward, y up; link j
        points along e_j = (sin, -cos), and t_j = (cos, sin) is the way it moves when its angle grows. Row 2 is
        link 2's moment about the knee, row 1 the whole leg's about the pivot.
        """
        b = self.body
        q1, q2, w1, q2d = x
        w2 = w1 + q2d
        e1x, t1x, e2x, t2x = sin(q1), cos(q1), sin(q1 + q2), cos(q1 + q2)
        e1y, t1y, e2y, t2y = -t1x, e1x, -t2x, e2x
        # centripetal part of each centre's acceleration, minus gravity: what is left when both angles' second
        # derivatives are zero
        r1x, r1y = -b.c1 * w1 * w1 * e1x, -b.c1 * w1 * w1 * e1y + b.gravity
        r2x = -b.l1 * w1 * w1 * e1x - b.c2 * w2 * w2 * e2x
        r2y = -b.l1 * w1 * w1 * e1y - b.c2 * w2 * w2 * e2y + b.gravity
        # and the parts that go with q1dd (j) and q2dd (k)
        jx, jy = b.l1 * t1x + b.c2 * t2x, b.l1 * t1y + b.c2 * t2y
        kx, ky = b.c2 * t2x, b.c2 * t2y
        # moments about the knee of link 2's inertial force, then about the pivot with link 1's
        m22 = b.i2 + b.m2 * b.c2 * (t2x * kx + t2y * ky)
        m21 = b.i2 + b.m2 * b.c2 * (t2x * jx + t2y * jy)
        rest2 = b.m2 * b.c2 * (t2x * r2x + t2y * r2y)
        m11 = b.i1 + b.m1 * b.c1 * b.c1 + m21 + b.m2 * b.l1 * (t1x * jx + t1y * jy)
        rest1 = b.m1 * b.c1 * (t1x * r1x + t1y * r1y) + rest2 + b.m2 * b.l1 * (t1x * r2x + t1y * r2y)
        torque1 = -b.viscous[0] * w1 - b.friction(0, modes[0], w1) * modes[0]
        torque2 = torque - b.viscous[1] * q2d - b.friction(1, modes[1], q2d) * modes[1]
        for effect in self.hidden:
            more1, more2 = effect(self.time_s, x, torque)
            torque1 += more1
            torque2 += more2
        return m11, m21, m22 + b.rotor, torque1 - rest1, torque2 - rest2
