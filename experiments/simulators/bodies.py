"""Rigid bodies that move as an identified model does.

Motion in a plane about a fixed pivot shows only combinations of body parameters, for two links

    p11 = I1 + m1 c1^2 + m2 l1^2,  p22 = I2 + m2 c2^2,  p12 = m2 l1 c2,  g1 = m1 c1 + m2 l1,  g2 = m2 c2,

five equations for seven unknowns (leg2: beta1 ... beta5). Joint torques and motion are functions of these five alone
(eq. (62)), so every choice of bodies that keeps them moves alike; what does depend on the choice are forces in the
bearings, and anything that lets the pivot move. The choice made here:

- l1 = p12 / g2 is not free: the motion shows it.
- m2 lies between g2^2 / p22 and p11 / l1^2 (both bodies then have inertia left), at the geometric mean of the two;
  such a mass exists exactly when the inertia matrix is positive definite, p12^2 < p11 p22.
- m1 = 2 s^2 / R, at least m2, with s = g1 - m2 l1 the first moment and R = p11 - m2 l1^2 the inertia left for body 1.
- c1 = s / m1, I1 = R - s^2 / m1, c2 = g2 / m2, I2 = p22 - g2^2 / m2.
- Inertias about the other axes, which a planar motion never uses, equal the one in the plane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from daq import InputError
from experiments.models import Model, build_mechanism

Inertial = tuple[float, float, float, float]
"""Mass, centre, inertia, length."""
REMEDY = "fit on runs that move both joints farther, or give a model of another rig"


@dataclass(frozen=True)
class Body:
    """One link with the joint that it hangs from. SI units."""

    link: str
    joint: str
    mass: float
    centre: float
    """Joint to centre of mass, along the link."""
    inertia: float
    """About the centre of mass."""
    length: float
    """Joint to the next joint; for the last body, which has none, as it is drawn."""
    viscous: float
    coulomb: float
    rotor: float
    """Reflected rotor inertia, in the joint's own row only."""
    offset: float
    """What the measured torque reads above the torque that acts."""
    driven: bool
    slides: bool = False


def bodies_of(model: Model, where: str) -> list[Body]:
    """Bodies from the pivot outwards. Raises `InputError` for a model that is no chain of one or two rigid bodies."""
    mechanism = build_mechanism(model.mechanism)
    settings, beta = model.mechanism, dict(zip(mechanism.names, model.beta))
    values = {(p.term, p.at): beta[p.name] for p in mechanism.parameters}
    if settings.input == "voltage":
        raise InputError(where, "is in volt units, a body needs newtons", "fit on runs with a measured torque")
    if mechanism.n > 2 or settings.model == "biped3":
        raise InputError(where, f"has {mechanism.n} links, and its parameters give contradictory lengths",
                         "give a model of one or two links")
    if settings.prismatic and settings.gravity_mps2:
        raise InputError(where, "is a slide with gravity, whose slope is not known",
                         "set gravity_mps2 = 0 for a level one")
    inertial = _two(values, where) if mechanism.n == 2 else [_one(values, where, settings.prismatic)]
    joints = ("pivot", "knee") if settings.model == "leg2" else tuple(f"joint{j + 1}" for j in range(mechanism.n))
    return [Body(f"link{j + 1}", joints[j], mass, centre, inertia, length, values.get(("viscous", (j,)), 0.0),
                 values.get(("coulomb", (j,)), 0.0), values.get(("rotor", (j,)), 0.0),
                 values.get(("offset", (j,)), 0.0), j in mechanism.actuated, settings.prismatic)
            for j, (mass, centre, inertia, length) in enumerate(inertial)]


def _one(values: dict[tuple[str, tuple[int, ...]], float], where: str, slides: bool) -> Inertial:
    """(mass, centre, inertia, length) of a single body."""
    inertia, moment = values["inertia", (0, 0)], values.get(("gravity", (0,)), 0.0)
    if inertia <= 0:
        raise InputError(where, f"gives the joint an inertia of {inertia:g}", REMEDY)
    if slides:
        return inertia, 0.0, inertia, 0.1
    mass = 2.0 * moment**2 / inertia or 1.0
    return mass, moment / mass, inertia - moment**2 / mass, 2.0 * abs(moment / mass) or 0.1


def _two(values: dict[tuple[str, tuple[int, ...]], float], where: str) -> list[Inertial]:
    """(mass, centre, inertia, length) of both bodies; the module's docstring has the equations."""
    p11, p22, p12 = (values["inertia", at] for at in ((0, 0), (1, 1), (0, 1)))
    g1, g2 = values["gravity", (0,)], values["gravity", (1,)]
    if p11 <= 0 or p22 <= 0 or p12**2 >= p11 * p22:
        raise InputError(where, "its inertia matrix is not positive definite, so no rigid bodies have it", REMEDY)
    if g2 == 0 or p12 / g2 <= 0:
        raise InputError(where, f"gives link 1 no length ({p12:g} kg m^2 over {g2:g} kg m)", REMEDY)
    l1 = p12 / g2
    m2 = math.sqrt(g2**2 / p22 * p11 / l1**2)
    left, s = p11 - m2 * l1**2, g1 - m2 * l1
    m1 = max(2.0 * s**2 / left, m2)
    c2 = g2 / m2
    return [(m1, s / m1, left - s**2 / m1, l1), (m2, c2, p22 - g2**2 / m2, 2.0 * abs(c2))]
