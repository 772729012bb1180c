"""The torque constant from holds of a link at several angles, with a known weight on it and without.

At rest the knee's motor carries gravity and what friction holds:

    K (i - i0) = g B sin(theta) + p m g r sin(theta) + (F + p F') s + e,

theta the link's angle from hanging, B its own first moment, p 1 with the weight m on the arm r and 0 without, s the
side from which the joint came to rest, which friction opposes. Divided by K this is linear in what is unknown. The
weight adds the slope m g r / K, and nothing else in the model goes with p sin(theta): the link's own gravity need not
be known. Terms in cos(theta) absorb a wrong zero of the angle, and a centre of mass off the link's axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from daq import FloatArray
from estimator.errors import FitError
from estimator.numerics import student_quantile

FEWEST = 6
"""Holds with the weight, and as many without."""
SPREAD = 0.15
"""Standard deviation of sin(theta) that the holds of either kind must have."""
WORST_CONDITION = 200.0
FRICTION_SHARE = 0.15
"""By so much friction may differ between hanging and the largest angle of either load: no scatter shows it, for it goes
with the angle as the weight does."""


class Holds(NamedTuple):
    """One entry a hold."""

    current: FloatArray
    """Mean reading of the current, in any unit: the constant comes out per this unit."""
    angle_rad: FloatArray
    """Of the driven link, absolute, 0 hanging."""
    side: FloatArray
    """+1: the joint came to rest while its angle grew, -1: while it fell."""
    weighted: FloatArray
    """1 with the weight, 0 without."""


class Weight(NamedTuple):
    """Weight and arm, each with half of its 95 % interval."""

    mass_kg: float
    arm_m: float
    """From the joint's axis to the weight's centre of mass, along the link."""
    mass_half_kg: float = 0.0
    arm_half_m: float = 0.0


class TorqueConstant(NamedTuple):
    """Joint torque per unit of current."""

    value: float
    half: float
    """Of the 95 % interval, weight and arm included."""
    half_holds: float
    """The share of the holds' scatter in it."""
    half_friction: float
    """The share of friction that differs with the angle."""
    friction_nm: float
    """F, without the weight."""
    own_moment_kgm: float
    """B"""
    residual_nm: float
    """Standard deviation of a hold about the model."""
    tilt_rad: float
    """Zero of the angle, as the weight shows it."""


def fit_torque_constant(holds: Holds, weight: Weight, gravity_mps2: float) -> TorqueConstant:
    """Torque constant by least squares over all holds at once; its interval from their scatter and the weight's.

    Raises `FitError` where holds are too few, or their angles or sides too much alike.
    """
    sine, cosine, p = np.sin(holds.angle_rad), np.cos(holds.angle_rad), holds.weighted
    for name, rows in (("with the weight", p == 1.0), ("without the weight", p == 0.0)):
        if rows.sum() < FEWEST:
            raise FitError(f"{rows.sum()} usable holds {name}, at least {FEWEST} are needed; hold at more levels")
        if np.std(sine[rows]) < SPREAD:
            raise FitError(f"the holds {name} are too much alike in angle; use more torque (--peak of legid excite)")
        if abs(holds.side[rows].sum()) == rows.sum():
            raise FitError(f"the holds {name} were all approached from one side, so friction passes for gravity; "
                           "approach them from both")
    table = np.column_stack([p * sine, p * cosine, sine, cosine, holds.side, p * holds.side, np.ones_like(sine)])
    scale = np.linalg.norm(table, axis=0)
    if np.linalg.cond(table / scale) > WORST_CONDITION:
        raise FitError("the holds' angles do not part the weight from the link's own gravity; hold on both sides "
                       "of hanging, over a wider range")
    theta = np.linalg.lstsq(table / scale, holds.current, rcond=None)[0] / scale
    residual, dof = holds.current - table @ theta, holds.current.size - theta.size
    cover = np.linalg.inv(table.T @ table) * float(residual @ residual) / dof
    slope = float(np.hypot(theta[0], theta[1]))
    if theta[0] <= 0.0:
        raise FitError("the weight acts in the wrong direction: current and angle disagree in sign; correct [motor] "
                       "sign or the encoder's direction")
    direction = theta[:2] / slope
    share = float(student_quantile(dof) * np.sqrt(direction @ cover[:2, :2] @ direction)) / slope
    one = direction @ np.linalg.pinv(table)[:2]
    by_friction = FRICTION_SHARE * sum(abs(float(one @ uneven)) for uneven in _uneven(theta, sine, holds)) / slope
    constant = weight.mass_kg * weight.arm_m * gravity_mps2 / slope
    known = float(np.hypot(weight.mass_half_kg / weight.mass_kg, weight.arm_half_m / weight.arm_m))
    half = constant * float(np.sqrt(share**2 + known**2 + by_friction**2))
    own_moment = constant * float(np.hypot(theta[2], theta[3])) / gravity_mps2
    return TorqueConstant(constant, half, constant * share, constant * by_friction, constant * float(theta[4]),
                          own_moment, constant * float(np.sqrt(residual @ residual / dof)),
                          float(np.arctan2(theta[1], theta[0])))


def _uneven(theta: FloatArray, sine: FloatArray, holds: Holds) -> list[FloatArray]:
    """For each load the friction's current (n,) that grows with the sine of the angle from nothing to all of it."""
    found = []
    for load, level in ((0.0, theta[4]), (1.0, theta[4] + theta[5])):
        mine = holds.weighted == load
        found.append(np.where(mine, level * holds.side * np.abs(sine) / np.abs(sine[mine]).max(), 0.0))
    return found
