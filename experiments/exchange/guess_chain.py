"""Units and signs of the angles and torques of a chain of joints, by its equation of motion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from msgspec import structs

from daq import Column, Dataset, FloatArray
from estimator import FIT_ERRORS, FitOptions
from estimator.calibration import ALIKE, CLEAR, LEAST_SPAN, MOST_SPAN, TRIED, Reading, Remedy, filtered_motion, read
from estimator.model import Mechanism, chain
from experiments.exchange.guess_names import says
from experiments.exchange.guess_physics import (
    EXPLAINS,
    NOT_SURE,
    SIGNS,
    Found,
    Sign,
    Way,
    bridged,
    close_call,
    scale_warnings,
    smooth,
)
from experiments.exchange.units import factor

SMOOTHING_RADPS = 0.05
"""Velocity over which the sign of friction is smoothed."""
TURNS = 4.0 * np.pi
"""A joint that follows commands turns less far [rad]."""
HANGS_RAD = 0.1
"""A zero of joint 1 further from hanging than this is reported."""


@dataclass(frozen=True, kw_only=True)
class _Columns(Remedy):
    """The angles in their units, relative or absolute, with signs of angles and torques."""

    units: tuple[str, ...]
    overrules: bool
    """Whether a unit is another than the name states."""
    signs: tuple[Sign, ...]
    works: tuple[Sign, ...]

    @property
    def absolute(self) -> bool:
        """Whether each angle counts against the world."""
        return bool(np.tril(self.angles, -1).any())

    def __str__(self) -> str:
        signs = [f"of {what} {' '.join(f'{s:+d}' for s in some)}"
                 for what, some in (("angles", self.signs), ("torques", self.works)) if some]
        return f"{self.units[-1] or 'rad'}{', absolute' * self.absolute}, signs {', '.join(signs)}"


@dataclass(frozen=True)
class _Way(Way):
    named: bool
    """Whether it is what the names say: their units, rad where they state none, and angles against the link before."""
    read: Reading[_Columns]

    @property
    def columns(self) -> _Columns:
        """The reading."""
        return self.read.remedy

    def __str__(self) -> str:
        return str(self.columns)


def find_chain(raw: Dataset, columns: Mapping[str, Column], gravity: float, pose: FloatArray | None = None) -> Found:
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
    driven = tuple(j for j in range(n) if {f"tau{j + 1}_nm", f"q{j + 1}_cmd_rad"} & columns.keys())
    mechanism = chain(n, gravity_mps2=gravity, actuated=driven, velocity_scale=SMOOTHING_RADPS)
    names = [f"q{k + 1}_rad" for k in range(n)]
    angles = names[pose is not None :]
    seen = raw.columns if pose is None else {**raw.columns, names[0]: pose}
    needed = [*names, *(f"tau{j + 1}_nm" for j in driven)]
    raw = replace(raw, columns={name: bridged(seen[name], raw.rate_hz) for name in needed})
    encoders = [columns[name] if name in angles else Column(name="", unit="rad") for name in names]
    follows = any(name.endswith("_cmd_rad") for name in columns)

    ways = _ranked(_ways(raw, mechanism, encoders, follows))
    first = ways[0]
    found = _found(ways, columns, [(name, columns[name]) for name in angles], _check(raw, mechanism, first))
    hangs = first.read.hangs_rad
    if n == 1 and driven and not found.unexplained and not follows and any(
            not way.read.faults and way.columns.works != first.columns.works
            and np.array_equal(way.columns.angles, first.columns.angles) for way in ways):
        found.unexplained.append(f"the sign of {columns['tau1_nm'].name!r} does not show: with either the inertia may "
                                 "be positive; import a record with faster motion")
        found.notes["tau1_nm"] = "NOT KNOWN: its sign does not show"
    if n > 1 and pose is None and first.left <= EXPLAINS and abs(hangs) > HANGS_RAD:
        found.warnings.append(f"joint 1 hangs at {hangs:.2f} rad, not at 0: set offset = {-hangs:.2f} under "
                              "[columns.q1_rad]")
    return found


def _ranked(ways: Iterable[_Way]) -> list[_Way]:
    """`ways`, what leaves least first; in front of it those by name, unless another explains, and far better."""
    out = sorted(ways, key=lambda way: way.left)
    named = [way for way in out if way.named]
    if not named or out[0].named or (out[0].left <= EXPLAINS and CLEAR * out[0].left < named[0].left):
        return out
    return named + [way for way in out if not way.named]


def _check(raw: Dataset, mechanism: Mechanism, way: _Way) -> tuple[FloatArray, FloatArray]:
    """The last joint's torque, or without motors joint 1's acceleration, and the same as the motion makes it."""
    q = np.stack([smooth(raw[f"q{k + 1}_rad"], raw.rate_hz) for k in range(mechanism.n)], axis=-1)
    q = q @ way.columns.angles.T - way.read.hangs_rad * np.eye(mechanism.n)[0]
    qd = np.gradient(q, 1.0 / raw.rate_hz, axis=0)
    z = mechanism.regressor(q, qd, np.gradient(qd, 1.0 / raw.rate_hz, axis=0))
    if not mechanism.actuated:
        return z[:, 0, 0], z[:, 0, 0] - z[:, 0] @ way.read.beta
    j = mechanism.actuated[-1]
    measured, made = way.columns.works[-1] * smooth(raw[f"tau{j + 1}_nm"], raw.rate_hz), z[:, j] @ way.read.beta
    return measured, made + np.mean(measured - made)


def _found(ways: Sequence[_Way], columns: Mapping[str, Column], angles: Sequence[tuple[str, Column]],
           check: tuple[FloatArray, FloatArray]) -> Found:
    """The map by the first of `ways`, with reasons and warnings."""
    first, read = ways[0], ways[0].columns
    said = all(angle.unit for _, angle in angles)
    rivals = [way for way in ways[1:] if way.columns.overrules == read.overrules and way.left != first.left
              and (not said or way.named == first.named or ALIKE * way.left < first.left)]
    second = min(rivals or ways[-1:], key=lambda way: way.left)
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
    unseen = read.absolute and len(angles) < len(read.signs)
    unknown = first.left > EXPLAINS or unseen
    if unknown:
        named, pushed = (", ".join(repr(column.name) for column in some)
                         for some in ([angle for _, angle in angles], [columns[name] for name in torques]))
        why = (f"no unit and sign of {named} explain {what}{pushed and f' {pushed}'} (the best leave "
               f"{100 * first.left:.0f} %): too little motion, a motor's angle before its gear, another order of the "
               "joints, other joints, a delay, an IMU that is turned, or no open chain")
        if "too short" in first.read.faults:
            why = f"the record is too short to show unit and sign of {named}"
        elif unseen:
            why = (f"{named} looks absolute, counted from the vertical (that leaves {100 * first.left:.0f} % of "
                   f"{what}): subtract the pivot's angle from it before it is read")
        if not commands:
            notes = {name: f"NOT KNOWN: no unit and sign explain {what}" for name, _ in angles}
            notes |= {name: "NOT KNOWN: its sign does not show" for name in torques}
            return Found(dict(columns), notes, warnings, [why], check, left=first.left)
        warnings.append(why)  # what a loop adds, a delay or an integral, is in the error, too
    elif read.overrules:
        stated = next(way for way in ways if not way.columns.overrules)
        warnings += [f"the name of {angle.name!r} says {angle.unit}, but in {unit or 'rad'} the equation of motion "
                     f"leaves {100 * first.left:.0f} % of {what}, not {100 * stated.left:.0f} %: {unit or 'rad'} is "
                     "taken" for (_, angle), unit in zip(angles, read.units[-len(angles) :]) if angle.unit != unit]
    close = [] if unknown else close_call("unit and signs", what, first, second)
    warnings += close
    prefix = NOT_SURE * bool(close or unknown)
    found, notes = dict(columns), {}
    for k, (column, angle) in enumerate(angles):
        unit, sign = (some[k - len(angles)] for some in (read.units, read.signs))
        less = angles[k - 1][1].name if read.absolute and k else ""
        found[column] = structs.replace(angle, unit=unit, minus=less, sign=sign)
        notes[column] = (f"{prefix}in {unit or 'rad'}, sign {sign:+d}, {less and f'less {less!r}, '}the equation of "
                         f"motion leaves {100 * first.left:.1f} % of {what} (next best: {100 * second.left:.0f} %)")
        command = columns.get(wanted := column.replace("_", "_cmd_", 1))
        if command is not None:
            found[wanted] = structs.replace(command, unit=command.unit or unit, sign=sign * command.sign)
    for column, sign in zip(torques, read.works):
        found |= {name: structs.replace(columns[name], sign=sign) for name in columns if name[:4] == column[:4]}
        notes[column] = f"{prefix}with sign {sign:+d} the inertia matrix is positive definite"
    return Found(found, notes, warnings, [], check, left=first.left)


def _ways(raw: Dataset, mechanism: Mechanism, angles: Sequence[Column], follows: bool) -> Iterator[_Way]:
    """Every unit and sign with what it leaves, and the angles against the world."""
    n, driven = mechanism.n, mechanism.actuated
    options = FitOptions(sensors="encoder", fixed={} if driven else {mechanism.names[0]: 1.0})
    span = np.array([np.ptp(smooth(raw[f"q{k + 1}_rad"], raw.rate_hz)) for k in range(n)])
    usual = "deg" if span.max() > (TURNS if follows else MOST_SPAN) else ""
    own = [factor(angle.unit, "q1_rad", angle.name) for angle in angles]
    scales: dict[tuple[float, ...], tuple[tuple[str, ...], bool]] = {}
    for overrules, unit in product((False, True), TRIED["rad"]):
        units = tuple(angle.unit if angle.unit and (not overrules or not angle.name) else unit for angle in angles)
        factors = tuple(factor(one, "q1_rad", "") / size for one, size in zip(units, own))
        if min(factors) >= 1.0 or np.max(factors * span) >= LEAST_SPAN:
            scales.setdefault(factors, (units, overrules))
    # a command counts as its angle does, which is not taken off another
    turns = [((1, *some), np.diag((1, *some))) for some in product(SIGNS, repeat=n - 1)]
    turns += [(SIGNS[:1] * n, np.eye(n) - np.eye(n, k=-1))] * (n > 1 and not follows)
    readings = []
    for (factors, (units, overrules)), (signs, turn) in product(scales.items(), turns):
        said = not (overrules or np.tril(turn, -1).any()) and all(
            angle.unit or unit == usual for angle, unit in zip(angles, units))
        for works in product(SIGNS, repeat=len(driven)):
            torques = np.zeros((n, n))
            torques[driven, driven] = works
            readings.append(_Columns("", "", turn * factors, np.zeros(n), torques, int(not said), units=units,
                                     overrules=overrules, signs=signs, works=works))
    found = [Reading(one, 1.0, ("too short",), False, np.zeros(mechanism.p)) for one in readings]
    with suppress(*FIT_ERRORS), np.errstate(all="ignore"):
        found = read(filtered_motion([raw], mechanism, options).thinned(), mechanism, options, readings, unknown=True)
    for reading in found:
        one, possible = reading.remedy, reading.positive
        if follows and n > 1:  # a drive pushes the angle towards its command
            possible &= one.works == one.signs[-len(one.works) :]
        yield _Way(reading.left if possible else max(reading.left, 1.0), not one.changes, reading)
