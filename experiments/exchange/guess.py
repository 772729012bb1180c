"""A guess of what the columns of somebody else's file are: by their names first, then by gravity and by work.

Names say what kind of signal a column is. What units and signs it has is left to physics, as far as physics shows it:

- an accelerometer at rest reads gravity: its unit follows from the median of its length, the axis along the link is the
  one that carries gravity, and outwards is where gravity does not pull (`accel_y = -g` while the link hangs);
- the gyro turns about the axis that moves most; its unit and sign are those under which gravity along the link's side
  follows its integral (`accel_x = l q1dd + g sin q1`, with one lever arm l);
- encoder and torque: the pivot carries no motor and the knee's torque does the knee's work, so that the equation of
  motion, linear in its nine parameters (eq. (62) of Dolinsky and Celikovsky, IEEE TCST 26(4), 2018), leaves the
  smallest residual, and positive inertias, under the right unit and signs.

What no unit and sign explains is said to be so (`Guess.unexplained`). What physics does not show stays as the file has
it: the torque's scale, which scales every parameter alike, and whether the leg is seen from its left or its right, on
which nothing depends.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from msgspec import structs

from daq import Column, InputError
from experiments.exchange.column_map import apply_map, only_time, with_scales
from experiments.exchange.guess_chain import find_chain
from experiments.exchange.guess_following import MOST_LINKS, guess_following, with_commands, with_loads, with_rates
from experiments.exchange.guess_leg import guess_leg
from experiments.exchange.guess_names import (
    MOST_RIVALS,
    WORDS,
    WRENCH,
    changes,
    clock_of,
    fitting,
    has,
    lacking,
    measured_columns,
    of_joints,
    same_joint,
    says,
    time_column,
    usable,
)
from experiments.exchange.guess_physics import Found
from experiments.exchange.guess_result import Guess, GuessedMap
from experiments.exchange.guess_rivals import unwrapped, without_copies
from experiments.exchange.imported import ImportedFile
from experiments.exchange.joint_choice import chosen_joints, first_run
from experiments.exchange.layouts import layout_warnings, stated
from experiments.exchange.units import unit_in_name

MAYBE_TORQUE = r"^[^a-z]*(u|v|input|control)[^a-z]*$|volt|pwm"
MADE_OF_OTHERS = 1e-4
"""An angle that is a sum of others but for this share of its spread is no joint of its own."""


def guess_map(imported: ImportedFile, gravity_mps2: float = 9.81, rate_hz: float | None = None,
              joints: Sequence[str] = (), scale: Mapping[str, float] | None = None) -> Guess:
    """Columns of `imported` with units and signs, for a hanging leg, a single joint or a chain.

    A file with one angle, one torque or none and no gyro or accelerometer is a single joint's. One with three angles or
    more, or with two torques, is a chain's whose joints all have encoders. Without torques, angles that follow
    commands are joints under position control. `joints` names those of many joints that are taken, a chain's from its
    base on. A file without times has `rate_hz` rows a second. `scale` has known factors by column.
    Raises `InputError`.
    """
    if rate_hz is not None:
        imported = _timed(imported, rate_hz)
    one, cell = first_run(imported)
    one = unwrapped(chosen_joints(one, joints) if joints else one)
    one, copies = (one, []) if has(one, "gyro", "accel") else without_copies(one)
    guess = _guess_one(one, gravity_mps2)
    columns = {name: structs.replace(column, name=column.name + cell, minus=column.minus and column.minus + cell)
               for name, column in guess.columns.items()}
    told = [text for text in (*copies, *guess.warnings, *layout_warnings(one, guess.columns))
            if not any(text.startswith(f"the scale of {name} does") for name in scale or {})]
    return Guess(with_scales(columns, scale or {}), guess.notes, told, guess.unexplained, guess.curves,
                 run=apply_map(one, guess.columns))


def _guess_one(imported: ImportedFile, gravity_mps2: float) -> GuessedMap:
    """The guess for a file with one run."""
    following, apart = guess_following(imported, gravity_mps2)
    found = following or with_commands(_guess_measured(imported, gravity_mps2), imported)
    return with_loads(with_rates(replace(found, warnings=[*found.warnings, *apart]), imported), imported)


def _guess_measured(imported: ImportedFile, gravity_mps2: float) -> GuessedMap:
    """The guess from measured angles, torques and IMU."""
    columns, notes, rivals = _by_name(imported)
    if _is_chain(imported):
        return _guess_chain(imported, columns, notes, gravity_mps2)
    if "q2_rad" not in columns or "tau2_nm" not in columns:
        absent = [name for name in ("q2_rad", "tau2_nm") if name not in columns]
        kinds = {"q2_rad": "q2", "tau2_nm": "tau"}
        raise lacking(imported, " and ".join(absent), {kinds[name]: WORDS[name] for name in absent})
    return guess_leg(imported, columns, notes, rivals, gravity_mps2)


def _timed(imported: ImportedFile, rate_hz: float) -> ImportedFile:
    """`imported` with `rate_hz` rows a second in each table without a column of times."""
    try:
        if all(table.time_s is None for table in imported.tables):
            time_column(imported)
            return imported
    except InputError:
        pass
    return replace(imported, tables=tuple(
        table if table.time_s is not None else
        table._replace(time_s=np.arange(next(iter(table.columns.values())).size) / rate_hz)
        for table in imported.tables if table.columns))


def _is_chain(imported: ImportedFile) -> bool:
    """One angle with one torque, angles of three joints or more, torques of two, or no torque; and no gyro or
    accelerometer, neither read nor left out."""
    angles, torques = _angles(imported), fitting(imported, "tau")
    some = 0 < len(torques) <= len(angles) <= MOST_LINKS and (
        len(angles) != 2 or (len(torques) == 2 and not same_joint(angles, torques)))
    some |= 1 <= len(angles) <= MOST_LINKS and not has(imported, "tau")
    return some and not has(imported, "gyro", "accel")


def _angles(imported: ImportedFile) -> list[str]:
    """Columns that are measured angles by their names, without those that are sums of others: by their numbers where
    each has one, else as in the file."""
    names = measured_columns(imported, "q1", "q2")
    own = _independent(imported, names, of_joints(names, fitting(imported, "tau")))
    numbers = [re.findall(r"\d+", name) for name in own]
    return sorted(own, key=lambda name: int(re.findall(r"\d+", name)[-1])) if all(numbers) else own


def _independent(imported: ImportedFile, names: list[str], driven: Collection[int]) -> list[str]:
    """Those of `names` that are no linear combination of others; angles of `driven` joints are kept before others."""
    values = [imported.values(name) for name in names]
    if len({x.size for x in values}) != 1:  # signals with times of their own
        return names
    known = usable(np.array(values)).all(axis=0)
    if known.sum() < len(names) + 2:
        return names
    centred = np.array([x[known] - x[known].mean() for x in values])
    kept: list[int] = []
    for k in sorted(range(len(names)), key=lambda k: (k not in driven, k)):
        base = centred[kept].T
        left = centred[k] - base @ np.linalg.lstsq(base, centred[k], rcond=None)[0]
        if left.std() > MADE_OF_OTHERS * centred[k].std():
            kept.append(k)
    return [names[k] for k in sorted(kept)]


def _guess_chain(imported: ImportedFile, columns: dict[str, Column], notes: dict[str, str], gravity_mps2: float
                 ) -> GuessedMap:
    """The guess for a chain of joints, each with an encoder.

    Where no column is a torque by its name, the chain swings freely, unless some column explains the motion better as
    the torque of a joint.
    """
    angles = _angles(imported)
    driven = of_joints(angles, measured_columns(imported, "tau"))
    theirs = {f"q{k}_rad": stated(imported, name, "q2_rad") for k, name in enumerate(angles, 1)}
    theirs |= {f"tau{j + 1}_nm": Column(name=name, unit=unit_in_name(name, "tau2_nm")) for j, name in driven.items()}

    def read(more: dict[str, Column]) -> Found:
        return find_chain(apply_map(imported, only_time(columns) | theirs | more), theirs | more, gravity_mps2)

    found, unnamed = read({}), [] if driven else imported.names
    maybe = [name for name in unnamed if says(name, MAYBE_TORQUE) and changes(imported.values(name))]
    warnings = [f"{name!r} may drive a joint, as its torque or its motor's voltage: call it [columns.tau1_nm] or "
                "[columns.tau2_nm], with scale in N m a unit, gear included" for name in maybe]
    axes = [name for name in unnamed if says(name, WRENCH)]
    moments = [name for name in axes if says(name, "torque|moment|/m[xyz]")] or axes
    if axes or any(read({f"tau{k}_nm": Column(name=name)}).left < found.left
                   for name in maybe for k in range(1, len(angles) + 1)):
        wrench = [f"{', '.join(map(repr, moments))}: a sensor of six axes, and no name says which of them is the "
                  "torque of which joint. Name it by [columns.tau1_nm], with sign = -1 where it is the reaction"
                  ] * bool(axes)
        unknown = dict.fromkeys(found.notes, "NOT KNOWN: no column is known to be its torque")
        return GuessedMap(theirs | only_time(columns), unknown, [], wrench + warnings)
    theirs = found.columns | only_time(columns)
    last = max((name for name in theirs if "tau" in name), default="")
    what = f"{last}: measured, and computed from the motion [N m]" if last else \
        "acceleration: measured, and computed from gravity and friction [rad/s²]"
    return GuessedMap(theirs, only_time(notes) | found.notes, found.warnings + warnings, found.unexplained,
                      {what: found.check})


def _by_name(imported: ImportedFile) -> tuple[dict[str, Column], dict[str, str], list[Column]]:
    """Time, angles and torques, with the units that names state; others that are the knee's angle by their names."""
    columns, notes = {}, {}
    rivals: list[Column] = []
    kinds = {"q1_rad": ("q1", True), "q2_rad": ("q2", True), "tau2_nm": ("tau", True), "tau2_cmd_nm": ("tau", False)}
    for name, kind in kinds.items():
        found = fitting(imported, *kind)
        if found:
            theirs, *others = found
            columns[name] = stated(imported, theirs, name)
            unit = columns[name].unit
            notes[name] = "by its name" + (f", in {unit}" if unit else "")
            if name == "q2_rad":
                rivals = [stated(imported, other, name) for other in others[:MOST_RIVALS]]
            elif others:
                notes[name] += f" (as {', '.join(map(repr, others[:MOST_RIVALS]))} could be)"
    clock, reasons = clock_of(imported)
    return columns | clock, notes | reasons, rivals
