"""Unit and sign of one joint's angle and torque, by its equation of motion; a joint without a motor swings freely."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from msgspec import structs

from daq import Column, Dataset, FloatArray
from experiments.exchange.guess_physics import (
    ANGLE_UNITS,
    CLEAR,
    EXPLAINS,
    NOT_SURE,
    SMOOTHING_RADPS,
    Found,
    Sign,
    inside,
    scale_warnings,
    share_left,
    smooth,
)
from experiments.exchange.units import factor

BLOCKS = 4
"""Parts of a record that must agree on the sign of the inertia."""


def find_joint(raw: Dataset, columns: Mapping[str, Column]) -> Found:
    """Unit of the angle and sign of the torque of one joint: tau = I qdd + b qd + c sgn(qd) + k sin q + h cos q.

    Gravity shows the unit, since it is a sine of the angle. The inertia is positive under the right sign of the
    torque. Without gravity the unit of an angle does not show: it stays as the file's name says, or in rad. Without
    `tau1_nm` in `columns` the joint swings freely: the other terms must explain the acceleration.
    """
    angle, torque = columns["q1_rad"], columns.get("tau1_nm")
    use = inside(raw, list(columns))
    stated = factor(angle.unit, "q1_rad", angle.name)
    rows = joint_regressors(raw, {unit: scale / stated for unit, scale in ANGLE_UNITS.items()})
    if torque is not None:
        push = smooth(raw["tau1_nm"], raw.rate_hz)
        read = {unit: (z, push) for unit, z in rows.items()}
    else:
        read = {unit: (z[:, 1:], z[:, 0]) for unit, z in rows.items()}
    left = {unit: left_of(z[use], push[use]) for unit, (z, push) in read.items()}
    by_name = next((unit for unit, scale in ANGLE_UNITS.items() if np.isclose(scale, stated)), "")
    best = min(left, key=left.__getitem__)
    clear = best == by_name or CLEAR * left[best] < left[by_name]
    unit = best if clear and left[best] <= EXPLAINS else by_name
    rival = min((other for other in left if other != unit), key=left.__getitem__)
    sure = left[rival] >= CLEAR * left[unit]
    (z, push), shown = read[unit], unit or "rad"
    what = "the acceleration" if torque is None else f"the torque {torque.name!r}"
    warnings, unexplained = [], []
    if left[unit] > EXPLAINS:
        unexplained.append(f"no unit of {angle.name!r} explains {what} (the best leaves {100 * left[unit]:.0f} %): too "
                           f"little motion, or {'a motor' if torque is None else 'the torque of another joint'}")
    if angle.unit and unit != by_name:
        warnings.append(f"the name of {angle.name!r} says {angle.unit}, but {shown} leaves {100 * left[unit]:.0f} % of "
                        f"{what}, not {100 * left[by_name]:.0f} %: {shown} is taken")
    if not angle.unit and not sure:
        warnings.append(f"the unit of {angle.name!r} does not show (rad or {rival or 'rad'}): {shown} is taken; set it "
                        "by hand if it is another")
    found = {"q1_rad": structs.replace(angle, unit=angle.unit if unit == by_name else unit)}
    notes = {}
    works: Sign = 1
    if torque is not None:
        works = 1 if _inertia(z[use], push[use]) > 0 else -1
        parts = zip(np.array_split(z[use], BLOCKS), np.array_split(push[use], BLOCKS))
        if not unexplained and any(_inertia(*part) * works <= 0 for part in parts):
            unexplained.append(f"the sign of {torque.name!r} does not show: parts of the record differ in the sign of "
                               "the inertia; import a record with faster motion")
        warnings += scale_warnings("tau1_nm", torque)
        found["tau1_nm"] = structs.replace(torque, sign=works)
        notes["tau1_nm"] = "NOT KNOWN: its sign does not show" if unexplained else (
            f"with sign {works:+d} the inertia is positive")
    prefix = "" if angle.unit or sure else NOT_SURE
    kind = "no torque: a joint that swings freely" if torque is None else "one torque: a single joint"
    notes["q1_rad"] = f"NOT KNOWN: it does not fit {what}" if unexplained else (
        f"{prefix}one angle and {kind}; in {shown} its equation of motion leaves {100 * left[unit]:.1f} % of "
        + ("the acceleration" if torque is None else "the torque"))
    return Found(found, notes, warnings, unexplained, (works * push, works * (z @ solve(z[use], push[use]))),
                 left=left[unit])


def joint_regressors(raw: Dataset, scales: Mapping[str, float]) -> dict[str, FloatArray]:
    """Unit -> (n, 5) of inertia, viscous and Coulomb friction, and gravity along two axes; q1_rad times its scale."""
    rows, step = {}, 1.0 / raw.rate_hz
    for unit, scale in scales.items():
        q = smooth(scale * raw["q1_rad"], raw.rate_hz)
        rate = np.gradient(q, step)
        rows[unit] = np.stack([np.gradient(rate, step), rate, np.tanh(rate / SMOOTHING_RADPS), np.sin(q), np.cos(q)],
                              axis=-1)
    return rows


def solve(z: FloatArray, tau: FloatArray) -> FloatArray:
    """(k,) by least squares."""
    return np.asarray(np.linalg.lstsq(z, tau, rcond=None)[0])


def _inertia(z: FloatArray, tau: FloatArray) -> float:
    return float(solve(z, tau)[0])


def left_of(z: FloatArray, tau: FloatArray) -> float:
    """The share of the torque that least squares leaves."""
    return share_left(tau, z @ solve(z, tau))
