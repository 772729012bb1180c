"""Columns that may be one angle or torque by their names: copies show in their values, else the equation of motion
chooses."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from daq import Column, Dataset, FloatArray
from experiments.exchange.guess_chain import find_chain
from experiments.exchange.guess_names import measured_columns
from experiments.exchange.guess_physics import Found
from experiments.exchange.imported import ImportedFile
from experiments.exchange.layouts import UNIT

CLEARLY = 0.9
"""A rival leaves less than this share of what the likeliest name leaves: copies of one signal leave alike."""
SAME, SLOPE, EXACT = 0.99, 0.02, 1.0 - 1e-9
"""Two columns are one angle again if their names are of one joint and they correlate by more than the first. Their
slope is one within the second share, or a motor's ratio. Exact copies may have any names without other numbers."""
MADE_FROM = re.compile(r"est|estimated?|hat|obs|observer|observed|kalman|kf|ekf|filt|filtered|smooth|raw|wrapped"
                       r"|unwrapped|unwrap|cont|meas|measured|actual|copy|enc|encoder|sim|rad|deg|motor|mot|rotor|load"
                       r"|link")
"""Words of a name that say how a column was made, and not of which joint it is."""
MOTOR = re.compile(r"motor|mot|rotor")
TURNS = {"rad": 2.0 * np.pi, "deg": 360.0}
WHAT = {"q2_rad": "the knee's angle", "tau2_nm": "its torque"}


def without_copies(imported: ImportedFile) -> tuple[ImportedFile, list[str]]:
    """The file without angles that are another one again, by correlation and slope, and a line for each of these.

    The one with the shortest name stays, and the link's side in place of the motor's.
    """
    names = sorted(measured_columns(imported, "q1", "q2"), key=lambda name: (
        bool(MOTOR.search(name.lower())), len(re.findall(r"[a-z]+", name.lower()))))
    kept, told = list[str](), dict[str, str]()
    for name in names:
        for own in kept:
            slope, correlation = _line(imported.values(own), imported.values(name))
            motor = bool(MOTOR.search(name.lower())) and _of_one_joint(own, name)
            alike = any(abs(slope / scale - 1.0) < SLOPE for scale in (1.0, 180.0 / np.pi, np.pi / 180.0))
            numbers = [re.findall(r"\d+", one) for one in (own, name)]
            copy = correlation > EXACT and numbers[0] == numbers[1]
            if copy or (correlation > SAME and (motor or (alike and _of_one_joint(own, name)))):
                what = f"the motor's side of {own!r}, ratio {slope:.4g}" if motor and not alike else f"{own!r} again"
                told[name] = f"{name!r} is {what} (correlation {correlation:.5f}, slope {slope:.4g}): left out"
                break
        else:
            kept.append(name)
    tables = [table._replace(columns={name: x for name, x in table.columns.items() if name not in told})
              for table in imported.tables]
    return replace(imported, tables=tuple(table for table in tables if table.columns)), list(told.values())


def unwrapped(imported: ImportedFile) -> ImportedFile:
    """The file with its angles as they go on over a turn, and as facts the units that these turns are in."""
    units, angles = dict[str, str](), dict[str, FloatArray]()
    for name in measured_columns(imported, "q1", "q2"):
        x = imported.values(name).copy()
        known = np.isfinite(x)
        span, jump = np.ptp(x[known]), np.abs(np.diff(x[known])).max()
        for unit, turn in TURNS.items():
            if 0.7 * turn < jump <= span < 1.01 * turn:
                x[known] = np.unwrap(x[known], period=turn)
                units[f"{UNIT}{name}"], angles[name] = unit, x
    tables = [table._replace(columns={name: angles.get(name, x) for name, x in table.columns.items()})
              for table in imported.tables]
    return replace(imported, tables=tuple(tables), facts={**imported.facts, **units})


def _of_one_joint(one: str, other: str) -> bool:
    """Whether two names differ in words alone that say how a column was made."""
    words = [set(re.findall(r"[a-z]+|\d+", name.lower())) for name in (one, other)]
    return all(map(MADE_FROM.fullmatch, words[0] ^ words[1]))


def _line(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Slope of y (n,) over x (n,) and the size of their correlation."""
    if x.size != y.size:
        return 0.0, 0.0
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    if x.size < 3 or np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return 0.0, 0.0
    correlation = float(np.corrcoef(x, y)[0, 1])
    return correlation * float(np.std(y) / np.std(x)), abs(correlation)


def best_knee(raw: Dataset, columns: Mapping[str, Column],
              rivals: Mapping[str, Sequence[tuple[Column, FloatArray]]], pose: FloatArray | None, gravity: float
              ) -> tuple[Found, dict[str, str]]:
    """The knee by the angle and the torque that agree best, and a note for each that had `rivals`: further columns and
    their readings, those of torques as plain numbers."""
    notes: dict[str, str] = {}
    best, run, used = find_chain(raw, columns, gravity, pose), raw, dict(columns)
    for name, others in rivals.items():
        tried = [(best, run, used)]
        for rival, values in others:
            other = replace(run, columns={**run.columns, name: values})
            tried.append((find_chain(other, {**used, name: rival}, gravity, pose), other, {**used, name: rival}))
        first, least = best.left, min(tried, key=lambda one: one[0].left)
        if others:
            left = ", ".join(f"{with_it[name].name!r} leaves {100 * one.left:.0f} %" for one, _, with_it in tried)
            notes[name] = f"of the columns that may be {WHAT[name]}: {left}"
        if least[0].left < CLEARLY * first:
            best, run, used = least
    return best, notes
