"""A leg's physical parameters, the coefficients of what may be wrong with it, and the layout of its state."""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
GRAVITY = 9.81


@dataclass(frozen=True)
class Leg:
    """Physical parameters [SI]; every field is a scalar or an array over lanes (L,)."""

    m1: Array | float = 1.3
    l1: Array | float = 0.30
    c1: Array | float = 0.16
    i1: Array | float = 0.012
    m2: Array | float = 0.8
    c2: Array | float = 0.15
    i2: Array | float = 0.007
    viscous1: Array | float = 0.02
    viscous2: Array | float = 0.03
    coulomb1: Array | float = 0.03
    coulomb2: Array | float = 0.05

    def lanes(self, count: int) -> "Leg":
        """The same leg with every field an array of `count` lanes."""
        return Leg(**{f.name: np.broadcast_to(np.asarray(getattr(self, f.name), float), (count,)).copy()
                      for f in fields(self)})

    def beta(self) -> Array:
        """The contract's nine parameters, shape (9,) or (9, L)."""
        return np.array([
            self.i1 + self.m1 * self.c1**2 + self.m2 * self.l1**2, self.i2 + self.m2 * self.c2**2,
            self.m2 * self.l1 * self.c2, self.m1 * self.c1 + self.m2 * self.l1, self.m2 * self.c2,
            self.viscous1, self.viscous2, self.coulomb1, self.coulomb2])


def stack(legs: list[Leg]) -> Leg:
    """Join scalar legs into one with a lane each."""
    return Leg(**{f.name: np.array([getattr(leg, f.name) for leg in legs], float) for f in fields(Leg)})


# Coefficients a lane may carry, zero when absent. Numbers at the end of a name are the joint.
COEFFICIENTS = (
    "stribeck2", "stribeck_velocity2",  # N m, rad/s
    "asymmetry2",  # N m more in the positive direction
    "asymmetric_drag2",  # N m s/rad more in the positive direction
    "load2",  # N m of dry friction per N m transmitted
    "bristle2",  # rad of LuGre deflection at full slip; replaces the dry friction
    "drag1", "drag2",  # N m s^2/rad^2
    "spring1", "spring2", "spring_rest1", "spring_rest2",  # N m/rad, rad
    "rotor", "gear",  # kg m^2 at the joint; ratio
    "ripple", "ripple_order", "ripple_phase",  # N m, per motor turn, rad
    "warmup", "warmup_time",  # N m of dry knee friction that dies out, s
    "stop_angle", "stop_stiffness", "stop_damping", "stop_side",  # rad, N m/rad^1.5, s/rad, +-1
    "shaft", "shaft_damping", "gap", "motor_inertia",  # N m/rad, N m s/rad, rad (whole play), kg m^2
    "base_mass", "base_stiffness", "base_damping",  # kg, N/m, N s/m
    "tilt", "tilt_rate", "tilt_phase",  # rad, rad/s, rad
    "slosh", "slosh_stiffness", "slosh_damping",  # kg m^2, N m/rad, N m s/rad
    "cable", "cable_yield",  # N m, rad
    "angle_friction", "angle_order", "angle_phase",  # N m of dry knee friction, per joint turn, rad
    "cross_damping",  # N m s/rad on the pivot by the knee's rate
)


@dataclass
class Rows:
    """Where each state sits in the state array."""

    motor: int = 0
    bristle2: int = 0
    base: int = 0
    slosh: int = 0
    cable: int = 0
    count: int = 4

    @classmethod
    def plan(cls, c: Mapping[str, Array]) -> "Rows":
        rows = cls()
        for name, key, width in (("motor", "shaft", 2), ("bristle2", "bristle2", 1),
                                 ("base", "base_mass", 2), ("slosh", "slosh", 2), ("cable", "cable", 1)):
            if c[key].any():
                setattr(rows, name, rows.count)
                rows.count += width
        return rows
