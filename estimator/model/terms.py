"""`TERMS`: what each kind of parameter multiplies in the equations of motion, and its derivatives.

The one table of terms. `Mechanism` makes regressor, inertia matrix and bias torque of it, `Collocation` the regressor
at Gauss points and its slopes, and the kernels of `regressor_numba` know a term by its place in it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from daq import FloatArray

ANGLE, RATE, ACCEL, RATE_FROM, RATE_TO = range(5)
"""Features of the motion at a Gauss point; the last two are the rates at the ends of its half interval."""


class Motion(NamedTuple):
    """Features at S points of K intervals, of joints or of links; each array (n, S, K)."""

    angle: FloatArray
    rate: FloatArray
    accel: FloatArray
    rate_from: FloatArray
    rate_to: FloatArray


class World(NamedTuple):
    """Constants that terms depend on in addition to the motion."""

    gravity: float
    """Factor of sin(theta); see `Mechanism.gravity`."""
    velocity_scale: FloatArray
    """(n,) by joint [rad/s]"""


@dataclass(frozen=True)
class Slope:
    """One non-zero derivative of one parameter's term."""

    row: int
    feature: int
    joint: int
    value: FloatArray | float
    """(S, K)"""


At = tuple[int, ...]
Part = tuple[int, FloatArray]
"""Row of the equations of motion, and what is added to it per unit of the parameter."""
Mass = tuple[int, int, FloatArray | float]
"""Row, column, and the entry of the inertia matrix per unit of the parameter."""


def smooth_sign(velocity: FloatArray, scale: float | FloatArray) -> FloatArray:
    """Smoothed sign v / sqrt(v^2 + scale^2), smoothing velocity `scale` [rad/s]. Same shape as `velocity`."""
    return velocity / np.sqrt(velocity * velocity + scale * scale)


def mean_sign(a: FloatArray, b: FloatArray, scale: float | FloatArray
              ) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean of v / sqrt(v^2 + scale^2) for v running linearly from a to b, and its derivatives by a and b.

    It is (a + b) / (|a|_scale + |b|_scale), with |v|_scale the root.
    """
    ra, rb = np.sqrt(a * a + scale**2), np.sqrt(b * b + scale**2)
    total = ra + rb
    mean = (a + b) / total
    return mean, (1.0 - mean * a / ra) / total, (1.0 - mean * b / rb) / total


class Term(ABC):
    """Contribution of one unit of a parameter to the equations of motion, mass . acceleration + bias.

    Angles x and rates v have the link, or the joint, first: (n, ...).
    """

    rigid = False
    """Whether it lives in absolute link angles; else in joint angles."""

    def mass(self, at: At, x: FloatArray) -> list[Mass]:
        """Factor of the accelerations."""
        return []

    def bias(self, at: At, x: FloatArray, v: FloatArray, world: World) -> list[Part]:
        """Value at zero accelerations."""
        return []

    @abstractmethod
    def linearised(self, at: At, motion: Motion, world: World) -> tuple[list[Part], list[Slope]]:
        """The whole term in a motion, each row (S, K), and its derivatives by the motion's features."""


class Inertia(Term):
    """p_ij: (c a_j + s v_j^2) at link i and (c a_i - s v_i^2) at link j, c and s of theta_i - theta_j."""

    rigid = True

    def mass(self, at: At, x: FloatArray) -> list[Mass]:
        i, j = at
        if i == j:
            return [(i, i, 1.0)]
        c = np.cos(x[i] - x[j])
        return [(i, j, c), (j, i, c)]

    def bias(self, at: At, x: FloatArray, v: FloatArray, world: World) -> list[Part]:
        i, j = at
        if i == j:
            return []
        s = np.sin(x[i] - x[j])
        return [(i, s * v[j] ** 2), (j, -s * v[i] ** 2)]

    def linearised(self, at: At, motion: Motion, world: World) -> tuple[list[Part], list[Slope]]:
        (i, j), (x, v, a, *_) = at, motion
        if i == j:
            return [(i, a[i])], [Slope(i, ACCEL, i, 1.0)]
        c, s = np.cos(x[i] - x[j]), np.sin(x[i] - x[j])
        si, sj = s * v[i], s * v[j]
        di = c * v[j] ** 2 - s * a[j]
        dj = -c * v[i] ** 2 - s * a[i]
        return [(i, c * a[j] + sj * v[j]), (j, c * a[i] - si * v[i])], [
            Slope(i, ANGLE, i, di), Slope(i, ANGLE, j, -di), Slope(i, RATE, j, 2 * sj), Slope(i, ACCEL, j, c),
            Slope(j, ANGLE, i, dj), Slope(j, ANGLE, j, -dj), Slope(j, RATE, i, -2 * si), Slope(j, ACCEL, i, c)]


class Gravity(Term):
    """g_i sin(theta_i)."""

    rigid = True

    def bias(self, at: At, x: FloatArray, v: FloatArray, world: World) -> list[Part]:
        return [(at[0], world.gravity * np.sin(x[at[0]]))]

    def linearised(self, at: At, motion: Motion, world: World) -> tuple[list[Part], list[Slope]]:
        i = at[0]
        return self.bias(at, motion.angle, motion.rate, world), [
            Slope(i, ANGLE, i, world.gravity * np.cos(motion.angle[i]))]


class Viscous(Term):
    """The joint's rate."""

    def bias(self, at: At, x: FloatArray, v: FloatArray, world: World) -> list[Part]:
        return [(at[0], v[at[0]])]

    def linearised(self, at: At, motion: Motion, world: World) -> tuple[list[Part], list[Slope]]:
        return [(at[0], motion.rate[at[0]])], [Slope(at[0], RATE, at[0], 1.0)]


class Coulomb(Term):
    """The smoothed sign of the joint's rate; over an interval of motion its mean."""

    def bias(self, at: At, x: FloatArray, v: FloatArray, world: World) -> list[Part]:
        return [(at[0], smooth_sign(v[at[0]], world.velocity_scale[at[0]]))]

    def linearised(self, at: At, motion: Motion, world: World) -> tuple[list[Part], list[Slope]]:
        j = at[0]
        mean, by_from, by_to = mean_sign(motion.rate_from[j], motion.rate_to[j], world.velocity_scale[j])
        return [(j, mean)], [Slope(j, RATE_FROM, j, by_from), Slope(j, RATE_TO, j, by_to)]


class Rotor(Term):
    """The joint's acceleration, in its own row only."""

    def mass(self, at: At, x: FloatArray) -> list[Mass]:
        return [(at[0], at[0], 1.0)]

    def linearised(self, at: At, motion: Motion, world: World) -> tuple[list[Part], list[Slope]]:
        return [(at[0], motion.accel[at[0]])], [Slope(at[0], ACCEL, at[0], 1.0)]


class Offset(Term):
    """One."""

    def bias(self, at: At, x: FloatArray, v: FloatArray, world: World) -> list[Part]:
        return [(at[0], np.ones_like(v[at[0]]))]

    def linearised(self, at: At, motion: Motion, world: World) -> tuple[list[Part], list[Slope]]:
        return self.bias(at, motion.angle, motion.rate, world), []


TERMS: dict[str, Term] = {"inertia": Inertia(), "gravity": Gravity(), "viscous": Viscous(), "coulomb": Coulomb(),
                          "rotor": Rotor(), "offset": Offset()}
CODES = {name: code for code, name in enumerate(TERMS)}
"""The number by which compiled kernels know a term."""
