"""Unit and sign of one joint's angle and torque, by its equation of motion; a joint without a motor swings freely."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from msgspec import structs

from daq import BoolArray, Column, Dataset, FloatArray
from estimator.model import chain
from experiments.exchange.guess_chain import regressor
from experiments.exchange.guess_physics import (
    CLEAR,
    EXPLAINS,
    NOT_SURE,
    SMOOTHING_RADPS,
    Found,
    Sign,
    Way,
    inside,
    overruled,
    ranked,
    scale_warnings,
    share_left,
    smooth,
    units_of,
)

ONE = chain(1, velocity_scale=SMOOTHING_RADPS)
BLOCKS = 4
"""Parts of a record that must agree on the sign of the inertia."""


def find_joint(raw: Dataset, columns: Mapping[str, Column]) -> Found:
    """Unit of the angle and sign of the torque of one joint: tau = I qdd + b qd + c sgn(qd) + k sin q + h cos q.

    Gravity shows the unit, since it is a sine of the angle. The inertia is positive under the right sign of the
    torque. Without gravity the unit of an angle does not show: it stays as the file's name says, or in rad. Without
    `tau1_nm` in `columns` the joint swings freely: the other terms must explain the acceleration.
    """
    angle, torque = columns["q1_rad"], columns.get("tau1_nm")
    use, what = inside(raw, list(columns)), "the acceleration" if torque is None else f"the torque {torque.name!r}"
    ways = readings(raw, use, units_of(angle), None if torque is None else smooth(raw["tau1_nm"], raw.rate_hz))
    first, second, *_ = ranked(ways, angle.unit)
    shown, sure = first.unit or "rad", second.left >= CLEAR * first.left
    warnings, unexplained = overruled(angle, ways, first.unit, what), []
    if first.left > EXPLAINS:
        unexplained.append(f"no unit of {angle.name!r} explains {what} (the best leaves {100 * first.left:.0f} %): too "
                           f"little motion, or {'a motor' if torque is None else 'the torque of another joint'}")
    if not angle.unit and not sure:
        warnings.append(f"the unit of {angle.name!r} does not show (rad or {second.unit or 'rad'}): {shown} is taken; "
                        "set it by hand if it is another")
    found = {"q1_rad": structs.replace(angle, unit=first.unit)}
    notes = {}
    works: Sign = 1
    if torque is not None:
        works = 1 if _solved(first.z[use], first.push[use])[0] > 0 else -1
        parts = zip(*(np.array_split(x[use], BLOCKS) for x in (first.z, first.push)))
        if not unexplained and any(_solved(*part)[0] * works <= 0 for part in parts):
            unexplained.append(f"the sign of {torque.name!r} does not show: parts of the record differ in the sign of "
                               "the inertia; import a record with faster motion")
        warnings += scale_warnings("tau1_nm", torque)
        found["tau1_nm"] = structs.replace(torque, sign=works)
        notes["tau1_nm"] = "NOT KNOWN: its sign does not show" if unexplained else (
            f"with sign {works:+d} the inertia is positive")
    prefix = "" if angle.unit or sure else NOT_SURE
    kind = "no torque: a joint that swings freely" if torque is None else "one torque: a single joint"
    notes["q1_rad"] = f"NOT KNOWN: it does not fit {what}" if unexplained else (
        f"{prefix}one angle and {kind}; in {shown} its equation of motion leaves {100 * first.left:.1f} % of "
        + ("the acceleration" if torque is None else "the torque"))
    return Found(found, notes, warnings, unexplained, (works * first.push, works * first.made), left=first.left)


@dataclass(frozen=True)
class Motion(Way):
    """The equation of motion of a joint whose angle is in one unit."""

    z: FloatArray
    """(n, k)"""
    push: FloatArray
    """(n,) what z explains: the torque; without one, the acceleration."""
    made: FloatArray
    """(n,) as z makes it"""


def readings(raw: Dataset, use: BoolArray, scales: Mapping[str, float], push: FloatArray | None
             ) -> list[Motion]:
    """The equation of motion with q1_rad times each of `scales` (unit -> factor): `push` (n,), or without it the
    acceleration, by inertia, viscous and Coulomb friction, and gravity along two axes."""
    found = []
    for unit, scale in scales.items():
        z = regressor(ONE, smooth(scale * raw["q1_rad"], raw.rate_hz)[:, None], raw.rate_hz)[:, 0]
        rows, wanted = (z[:, 1:], z[:, 0]) if push is None else (z, push)
        made = rows @ _solved(rows[use], wanted[use])
        found.append(Motion(share_left(wanted[use], made[use]), unit, rows, wanted, made))
    return found


def _solved(z: FloatArray, tau: FloatArray) -> FloatArray:
    """(k,) by least squares."""
    return np.asarray(np.linalg.lstsq(z, tau, rcond=None)[0])
