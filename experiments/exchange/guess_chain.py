"""Units and signs of the angles and torques of a chain of joints, by its equation of motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from msgspec import structs

from daq import Column, Dataset, FloatArray
from estimator.calibration import MOST_SPAN, TRIED
from estimator.model import Mechanism, chain
from experiments.exchange.guess_names import says
from experiments.exchange.guess_physics import (
    EXPLAINS,
    NOT_SURE,
    SIGNS,
    Found,
    Pose,
    Sign,
    Way,
    close_call,
    inside,
    ranked,
    scale_warnings,
    share_left,
    smooth,
)
from experiments.exchange.units import factor

SMOOTHING_RADPS = 0.05
"""Velocity over which the sign of friction is smoothed."""
MOST_ROWS = 1500
"""Instants, evenly taken, at which the equation of motion is put up."""
POSES = 20
"""Instants at which the inertia matrix must be positive definite."""
BLOCKS = 4
"""Parts of a single joint's record that must agree on the sign of the inertia."""
TURNS = 4.0 * np.pi
"""A joint that follows commands turns less far [rad]."""
HANGS_RAD = 0.1
"""A zero of joint 1 further from hanging than this is reported."""


@dataclass(frozen=True)
class _Reading(Way):
    """The angles in their units, relative or absolute, with signs of angles and torques."""

    units: tuple[str, ...]
    overrules: bool
    """Whether a unit is another than the name states."""
    absolute: bool
    signs: tuple[Sign, ...]
    works: tuple[Sign, ...]
    angles: FloatArray
    """(n, n) q = angles @ q_read"""
    beta: FloatArray
    """(p + links,) by least squares"""

    def __str__(self) -> str:
        signs = [f"of {what} {' '.join(f'{s:+d}' for s in some)}"
                 for what, some in (("angles", self.signs), ("torques", self.works)) if some]
        return f"{self.units[-1] or 'rad'}{', absolute' * self.absolute}, signs {', '.join(signs)}"


def find_chain(raw: Dataset, columns: Mapping[str, Column], gravity: float, pose: Pose | None = None) -> Found:
    """Units of the angles and signs of angles and torques of a chain of joints, by tau = Z beta.

    `columns` are q1_rad, q2_rad, ... and the torque of each driven joint, or the command that it follows: then the
    torque of `raw` is the command's error. A chain without either swings freely, and the other terms must explain what
    the first inertia needs. The equation of motion must leave little of the torques under the right units and signs,
    with a positive definite inertia matrix. The unit of a name stays unless another one explains far better; without
    gravity units do not show. Absolute angles are tried, too. With `pose` an IMU has the motion of joint 1. Columns
    that nothing explains are left as they stand in the file. Whether the chain is seen from its left or its right does
    not show: joint 1's angle keeps its sign.
    """
    n = max(int(name[1]) for name in columns if name[0] == "q")
    driven = [j for j in range(n) if {f"tau{j + 1}_nm", f"q{j + 1}_cmd_rad"} & columns.keys()]
    mechanism = chain(n, gravity_mps2=gravity, velocity_scale=SMOOTHING_RADPS)
    names = [f"q{k + 1}_rad" for k in range(n)]
    read, pushed = names[pose is not None :], [f"tau{j + 1}_nm" for j in driven]
    motion = _motion(raw, read, pose)
    torque = np.zeros(motion[0].shape)
    for j, name in zip(driven, pushed):
        torque[:, j] = smooth(raw[name], raw.rate_hz)
    use = inside(raw, [*read, *pushed])
    rows = np.flatnonzero(use)[:: max(1, int(use.sum()) // MOST_ROWS)]
    encoders = [columns[name] if name in read else Column(name="", unit="rad") for name in names]
    follows = any(name.endswith("_cmd_rad") for name in columns)

    # a command counts as its angle does, which is not taken off another
    absolute = pose is None and not follows
    ways = ranked(_readings(mechanism, motion[:, rows], torque[rows], driven, encoders, absolute, follows))
    first = ways[0]
    z = regressor(mechanism, motion @ first.angles.T)[:, driven[-1] if driven else 0]
    made = z @ first.beta
    check = (first.works[-1] * torque[:, driven[-1]], made) if driven else (z[:, 0], z[:, 0] - made)
    found = _found(ways, columns, [(name, columns[name]) for name in read], check)
    parts = zip(*(np.array_split(x[rows], BLOCKS) for x in (z, check[0])))
    if n == 1 and driven and not found.unexplained and not follows and any(
            np.linalg.lstsq(one, push, rcond=None)[0][0] <= 0.0 for one, push in parts):
        found.unexplained.append(f"the sign of {columns['tau1_nm'].name!r} does not show: parts of the record differ "
                                 "in the sign of the inertia; import a record with faster motion")
        found.notes["tau1_nm"] = "NOT KNOWN: its sign does not show"
    tilt = _hangs_at(mechanism, first.beta)
    if n > 1 and pose is None and first.left <= EXPLAINS and abs(tilt) > HANGS_RAD:
        found.warnings.append(f"joint 1 hangs at {tilt:.2f} rad, not at 0: set offset = {-tilt:.2f} under "
                              "[columns.q1_rad]")
    return found


def _motion(raw: Dataset, read: Sequence[str], pose: Pose | None) -> FloatArray:
    """(3, N, n) q, qd and qdd, smoothed: of joint 1 by `pose`, where there is one, of others by the angles `read`."""
    angles = [*([] if pose is None else [pose.q1]), *(raw[name] for name in read)]
    q = np.stack([smooth(x, raw.rate_hz) for x in angles], axis=-1)
    qd = np.gradient(q, 1.0 / raw.rate_hz, axis=0)
    if pose is not None:
        qd[:, 0] = smooth(pose.rate, raw.rate_hz)
    return np.stack([q, qd, np.gradient(qd, 1.0 / raw.rate_hz, axis=0)])


def _found(ways: Sequence[_Reading], columns: Mapping[str, Column], angles: Sequence[tuple[str, Column]],
           check: tuple[FloatArray, FloatArray]) -> Found:
    """The map by the first of `ways`, with reasons and warnings."""
    first = ways[0]
    second = next((way for way in ways[1:] if way.overrules == first.overrules and way.left != first.left), first)
    torques = [name for name in columns if name.startswith("tau") and "cmd" not in name]
    commands = [name for name in columns if name.endswith("_cmd_rad")]
    several = "s" * (max(len(torques) or len(angles), 1) > 1)
    what = f"the torque{several}" if torques else "the command's error" if commands else f"the acceleration{several}"
    warnings = [text for name in torques for text in scale_warnings(name, columns[name])]
    warnings += [f"{angle.name!r} sounds like the motor's angle: then set unit, scale (1 / gear ratio) by hand"
                 for _, angle in angles if not angle.unit and says(angle.name, "motor")]
    if not torques and not commands:
        warnings.append("no torque: the joints swing freely. Write actuated = [] under [mechanism], and give legid fit "
                        "one parameter with --fix: without a torque only ratios show")
    unknown = first.left > EXPLAINS
    if unknown:
        named, pushed = (", ".join(repr(column.name) for column in some)
                         for some in ([angle for _, angle in angles], [columns[name] for name in torques]))
        why = (f"no unit and sign of {named} explain {what}{pushed and f' {pushed}'} (the best leave "
               f"{100 * first.left:.0f} %): too little motion, a motor's angle before its gear, another order of the "
               "joints, other joints, a delay, an IMU that is turned, or no open chain")
        if not commands:
            notes = {name: f"NOT KNOWN: no unit and sign explain {what}" for name, _ in angles}
            notes |= {name: "NOT KNOWN: its sign does not show" for name in torques}
            return Found(dict(columns), notes, warnings, [why], check, left=first.left)
        warnings.append(why)  # what a loop adds, a delay or an integral, is in the error, too
    elif first.overrules:
        stated = next(way for way in ways if not way.overrules)
        warnings += [f"the name of {angle.name!r} says {angle.unit}, but in {unit or 'rad'} the equation of motion "
                     f"leaves {100 * first.left:.0f} % of {what}, not {100 * stated.left:.0f} %: {unit or 'rad'} is "
                     "taken" for (_, angle), unit in zip(angles, first.units[-len(angles) :]) if angle.unit != unit]
    close = [] if unknown else close_call("unit and signs", what, first, second)
    warnings += close
    prefix = NOT_SURE * bool(close or unknown)
    found, notes = dict(columns), {}
    for k, (column, angle) in enumerate(angles):
        unit, sign = (some[k - len(angles)] for some in (first.units, first.signs))
        less = angles[k - 1][1].name if first.absolute and k else ""
        found[column] = structs.replace(angle, unit=unit, minus=less, sign=sign)
        notes[column] = (f"{prefix}in {unit or 'rad'}, sign {sign:+d}, {less and f'less {less!r}, '}the equation of "
                         f"motion leaves {100 * first.left:.1f} % of {what} (next best: {100 * second.left:.0f} %)")
        command = columns.get(wanted := column.replace("_", "_cmd_", 1))
        if command is not None:
            found[wanted] = structs.replace(command, unit=command.unit or unit, sign=sign * command.sign)
    for column, sign in zip(torques, first.works):
        found |= {name: structs.replace(columns[name], sign=sign) for name in columns if name[:4] == column[:4]}
        notes[column] = f"{prefix}with sign {sign:+d} the inertia matrix is positive definite"
    return Found(found, notes, warnings, [], check, left=first.left)


def _readings(mechanism: Mechanism, motion: FloatArray, torque: FloatArray, driven: Sequence[int],
              angles: Sequence[Column], absolute: bool, follows: bool) -> Iterator[_Reading]:
    """Every unit and sign with what it leaves, and with `absolute` the angles against the world."""
    n = mechanism.n
    usual = "deg" if np.ptp(motion[0], axis=0).max() > (TURNS if follows else MOST_SPAN) else ""
    own = [factor(angle.unit, "q1_rad", angle.name) for angle in angles]
    scales: dict[tuple[float, ...], tuple[tuple[str, ...], bool]] = {}
    for overrules, unit in product((False, True), TRIED["rad"]):
        units = tuple(angle.unit if angle.unit and (not overrules or not angle.name) else unit for angle in angles)
        scales.setdefault(tuple(factor(one, "q1_rad", "") / size for one, size in zip(units, own)), (units, overrules))
    turns = [((1, *some), np.diag((1, *some)), False) for some in product(SIGNS, repeat=n - 1)]
    turns += [(SIGNS[:1] * n, np.eye(n) - np.eye(n, k=-1), True)] * (absolute and n > 1)
    for (factors, (units, overrules)), (signs, turn, less) in product(scales.items(), turns):
        read = turn * factors
        moved = motion @ read.T
        z, poses = regressor(mechanism, moved), moved[0, :: max(1, moved.shape[1] // POSES)]
        named = not (overrules or less) and all(angle.unit or unit == usual for angle, unit in zip(angles, units))
        for works, left, beta in _fits(z, torque, driven):
            possible = np.linalg.eigvalsh(mechanism.inertia_matrix(poses, beta[: mechanism.p])).min() > 0.0
            if follows and n > 1:  # a drive pushes the angle towards its command
                possible &= works == signs[-len(works) :]
            left = left if possible else max(left, 1.0)
            yield _Reading(left, named, units, overrules, less, signs, works, read, beta)


def _fits(z: FloatArray, torque: FloatArray, driven: Sequence[int]
          ) -> Iterator[tuple[tuple[Sign, ...], float, FloatArray]]:
    """Signs of the torques (m, n), what least squares of the equation of motion leaves of them, and its parameters.

    The normal equations are put up once: the signs enter their right-hand side alone. Without a motor Z beta = 0 is
    solved in units of the first inertia.
    """
    flat = z.reshape(-1, z.shape[-1])
    if not driven:
        rest = np.linalg.lstsq(flat[:, 1:], -flat[:, 0], rcond=None)[0]
        yield (), share_left(-flat[:, 0], flat[:, 1:] @ rest), np.append(1.0, rest)
        return
    inverse = np.linalg.pinv(flat.T @ flat, hermitian=True)
    parts = np.einsum("njk,nj->jk", z, torque)
    power = max(float(np.sum(torque**2)), 1e-30)
    for works in product(SIGNS, repeat=len(driven)):
        right = np.array(works, dtype=float) @ parts[list(driven)]
        beta = inverse @ right
        yield works, float(np.sqrt(max(1.0 - right @ beta / power, 0.0))), beta


def regressor(mechanism: Mechanism, motion: FloatArray) -> FloatArray:
    """(N, n, p + links) of tau = Z beta + Z_g beta_g by `motion` (3, N, n): the mechanism, then gravity with joint 1 a
    quarter turn ahead."""
    z = mechanism.regressor(*motion)
    ahead, still = motion[0].copy(), np.zeros_like(motion[0])
    ahead[:, 0] += 0.5 * np.pi
    return np.concatenate([z, mechanism.regressor(ahead, still, still)[..., _gravity(mechanism)]], axis=-1)


def _hangs_at(mechanism: Mechanism, beta: FloatArray) -> float:
    """Joint 1's angle when the chain hangs [rad], by the first moment that is largest."""
    along, ahead = beta[_gravity(mechanism)], beta[mechanism.p :]
    heavy = int(np.argmax(np.hypot(along, ahead)))
    return -float(np.arctan2(ahead[heavy], along[heavy]))


def _gravity(mechanism: Mechanism) -> list[int]:
    return [k for k, p in enumerate(mechanism.parameters) if p.term == "gravity"]
