"""Joints and the run of a file with many of them that a guess looks at."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from daq import InputError
from experiments.exchange.column_map import ANY
from experiments.exchange.guess_names import kind_of, measured_columns, of_joints, says
from experiments.exchange.guess_servo import commands_of
from experiments.exchange.imported import ImportedFile

CELL = re.compile(r"\{\d+\}$")
MOST_NAMED = 24


def first_run(imported: ImportedFile) -> tuple[ImportedFile, str]:
    """The first run of a file with a table for each run, and the ending by which its columns name those of all runs.

    The ending is empty for any other file, which is returned as it is."""
    if len(imported.tables) < 2 or not all(CELL.search(name) for name in imported.names):
        return imported, ""
    table = imported.tables[0]
    own = {CELL.sub("", name): values for name, values in table.columns.items()}
    return replace(imported, tables=(table._replace(columns=own),)), ANY


def chosen_joints(imported: ImportedFile, joints: Sequence[str]) -> ImportedFile:
    """`imported` with the angles, commands and torques of `joints` alone, in their order.

    A joint is named by its angle's column, by words of that name which no other angle has, or by its number in the
    file from 1. Raises `InputError`.
    """
    angles, commands = measured_columns(imported, "q1", "q2"), commands_of(imported)
    theirs: dict[str, list[str]] = {angle: [angle] for angle in angles}
    for others in (commands, measured_columns(imported, "tau")):
        for joint, name in of_joints(angles, others).items():
            theirs[angles[joint]].append(name)
    kept = [name for joint in joints for name in theirs[_angle_of(imported, joint, angles)]]
    given_up = {name for name in imported.names if name in (*angles, *commands) or kind_of(name) == "tau"} - set(kept)
    tables = [table._replace(columns={name: table.columns[name] for name in [*kept, *table.columns]
                                      if name in table.columns and name not in given_up}) for table in imported.tables]
    return replace(imported, tables=tuple(table for table in tables if table.columns))


def _angle_of(imported: ImportedFile, joint: str, angles: Sequence[str]) -> str:
    if joint in angles:
        return joint
    if joint.isdecimal() and 1 <= int(joint) <= len(angles):
        return angles[int(joint) - 1]
    found = [angle for angle in angles if says(angle, rf"(?<![a-z0-9]){re.escape(joint)}(?![a-z0-9])")]
    if len(found) == 1:
        return found[0]
    named = ", ".join(map(repr, angles[:MOST_NAMED])) or "none"
    raise InputError(imported.name, f"{'several angles are' if found else 'no angle is'} called {joint!r}",
                     f"give --joints one of {named}")


def too_many(imported: ImportedFile, angles: Sequence[str]) -> InputError:
    """The error for a file of more joints than one plane has."""
    named = ", ".join(map(repr, angles[:MOST_NAMED])) + (", ..." if len(angles) > MOST_NAMED else "")
    return InputError(imported.name, f"holds {len(angles)} joints: {named}",
                      "choose one by --joints NAME, or the joints of one plane from the base on by --joints A,B,C")
