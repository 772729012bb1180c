"""Kind of signal of a column by its name, and the column of times."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from daq import BoolArray, Column, FloatArray, InputError
from daq.runs import MOST, unwrapped_counter
from experiments.exchange.column_map import TIME
from experiments.exchange.imported import ImportedFile
from experiments.exchange.units import BRACKETED, factor, unit_in_name

PATTERNS = {
    "gyro": r"gyr|angular_?vel|omega|ang_?rate|(?<![a-z])[gw][xyz](?![a-z])|imu.*rate",
    "accel": r"acc|linear_accel|(?<![a-z])a[xyz](?![a-z])",
    "tau": r"torque|effort|\btau|_tau|trq|moment|\btq|current|strom|iq_|_iq|\biq\b",
    "q1": r"\bq1|q_?1_|hip|pivot|joint_?1\b|shoulder|joint_?0\b",
    "q2": r"\bq_?[2-9]|q_?[2-9]_|knee|knie|joint_?[2-9]\b|ankle|wrist|elbow|torso|trunk|pos|angle|winkel"
          r"|enc(?![eyh])|theta|(?<![a-z])phi|\bq\b|observation\.state",
}
"""Kind of signal -> how columns that hold it are called; of several kinds the first one counts."""
NOT_MEASURED = (r"cmd|command|set_?point|desired|(?<![a-z])des(?![a-z])|target|ref|goal|input_|clip|(?<![a-z])action"
                r"|joint_trajectory|feed_?forward|(?<![a-z])ff(?![a-z])")
WORDS = {"gyro": "gyro, omega, wz or gz", "accel": "acc, ax",
         "tau2_nm": "torque, effort, tau, current or iq, or, for a drive that follows an angle, cmd, goal or target",
         "q2_rad": "knee, q2, angle, position or encoder", "q1_rad": "hip, q1 or pivot", TIME: "time, t or stamp"}
"""What a person is told to call them."""
NOT_AN_ANGLE = r"vel|speed|rate|dot|temp|volt|err|status|fault|acc|imu|force|wrench|torque"
WRENCH = r"wrench|netft"
"""A sensor of six axes, none of which is a joint's torque by its name."""
LOAD = r"^observation\.load_"
"""A load of LeRobot, whose unit no file states."""
SETTING = r"enable|limit"
"""Of a drive, no reading."""
LEAST = 1e-300
"""Smaller numbers are memory that nobody wrote to, read as a double."""
TIME_NAMES = (r"^_*(time|t|timestamp|stamp|sec|seconds|zeit(?:stempel)?|clock|millis|micros|elapsed|time_.*|t_.*|"
              r".*timestamp.*|.*time)$")
STEP_S = (0.0002, 0.1)
"""Steps between which a log of a leg lies: they tell seconds from milliseconds."""
UNNAMED = re.compile(r"column \d+")
"""What a reader calls a column of a table without a header."""
TIME_REMEDIES = {"digits only": "export the times with more digits, or leave the column out and give --rate HZ",
                 "is the step": "give the rate by --rate HZ",
                 "stands still": "export times of a finer resolution, or give --rate HZ for rows at one rate"}
"""What a column of times lacks -> the remedy."""
AXIS = r"[^a-z0-9]?([xyz])(?:[\s\[(_].*)?$"
MOST_RIVALS = 4
"""Columns that are tried in addition to the most likely one."""


def says(name: str, pattern: str) -> bool:
    """Whether a part of a column's name has this pattern, in small letters or capitals."""
    return bool(re.search(pattern, name, re.IGNORECASE))


def kind_of(name: str) -> str:
    """Kind of signal in `PATTERNS` by a column's name; empty for none."""
    if says(name, f"{WRENCH}|{SETTING}|{LOAD}"):
        return ""
    return next((kind for kind, pattern in PATTERNS.items() if says(name, pattern)), "")


def lacking(imported: ImportedFile, what: str, words: Mapping[str, str]) -> InputError:
    """The error for a file without `what`; `words`: kind of signal -> how such columns are called.

    A column that is called so and cannot be used is named with the reason."""
    useless = [f"{name!r} {why}" for name, why in imported.left_out.items()
               if kind_of(name) in words or not imported.names]
    for name in imported.names:
        values = imported.values(name)
        if kind_of(name) in words and not changes(values):
            useless.append(f"{name!r} {_unchanging(values)}")
    if useless:
        return InputError(imported.name, f"lacks {what}: {', '.join(useless[:6])}",
                          "correct those cells, or map another column by hand: see docs/exchange.md")
    if imported.names and all(map(UNNAMED.fullmatch, imported.names)):
        return InputError(imported.name, f"has no header line: its {len(imported.names)} columns have no names",
                          'write the map by hand, name = "column 2" for the second: see docs/exchange.md')
    names = ", ".join(map(repr, imported.names[:20]))
    return InputError(imported.name, f"lacks {what} by the names of its columns: {names}",
                      f"name it by a word such as {'; '.join(words.values())}, or " + (
                          "give its rate by --rate HZ" if TIME in words else
                          "write the map by hand, see docs/exchange.md"))


def usable(values: FloatArray) -> BoolArray:
    """(n,) True for numbers that a reading may have."""
    return np.isfinite(values) & (np.abs(values) <= MOST)


def changes(values: FloatArray) -> bool:
    """Whether a column (n,) has three usable numbers, and not one number alone."""
    known = values[usable(values)]
    return bool(known.size > 2 and np.ptp(known) > LEAST)


def _unchanging(values: FloatArray) -> str:
    """Why a column (n,) that does not change is of no use, in few words."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "is blank"
    return "never changes" if np.ptp(known) == 0.0 else f"holds no torque (all readings are below {LEAST:g})"


def has(imported: ImportedFile, *kinds: str) -> bool:
    """Whether a column is of one of these kinds by its name, read or left out."""
    return any(kind_of(name) in kinds for name in [*imported.names, *imported.left_out])


def fitting(imported: ImportedFile, kind: str, measured: bool = True) -> list[str]:
    """The columns that may be of this kind by their names, the most likely first."""
    found = [name for name in imported.names if kind_of(name) == kind and says(name, NOT_MEASURED) != measured
             and not says(name, TIME_NAMES) and not (kind in ("q1", "q2") and says(name, NOT_AN_ANGLE))
             and changes(imported.values(name))]
    return sorted(found, key=lambda name: (not says(name, "knee|knie|2"), says(name, "current|strom|iq")))


def measured_columns(imported: ImportedFile, *kinds: str) -> list[str]:
    """Columns that are measured signals of one of these kinds by their names, in the file's order."""
    found = {name for kind in kinds for name in fitting(imported, kind)}
    return [name for name in imported.names if name in found]


def triad(imported: ImportedFile, kind: str) -> list[str]:
    """Columns of a sensor with up to three axes."""
    names = [name for name in imported.names if kind_of(name) == kind and "bias" not in name.lower()
             and usable(imported.values(name)).sum() > 2]
    axes = [name for name in names if says(name, AXIS)]
    return (axes or names)[:3]


def time_column(imported: ImportedFile) -> tuple[Column, str]:
    """The column that increases and is called so; its unit by its name, else by the step."""
    useless = [f"{name!r} {why}" for name, why in imported.left_out.items() if _called_time(name)]
    for name in sorted(imported.names, key=lambda n: not _called_time(n)):
        values = imported.values(name)
        known = np.flatnonzero(np.isfinite(values))
        wraps = unwrapped_counter(values[known], factor(unit_in_name(name, TIME), TIME, name))
        steps = np.diff(values[known] if wraps is None else wraps.time)
        wrapped = "" if wraps is None else f"; it wraps by {wraps.modulus:.10g}, first in row {wraps.rows[0] + 1}"
        if known.size < 0.99 * values.size or (steps >= 0).mean() <= 0.99 or np.median(steps) <= 0:
            if _called_time(name):
                useless.append(f"{name!r} {_not_a_clock(values if wraps is None else wraps.time)}")
            continue
        unit = unit_in_name(name, TIME)
        if unit:
            return Column(name=name, unit=unit), f"by its name, which says {unit}{wrapped}"
        step = float(np.median(steps[steps > 0]))
        scales = {"": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
        units = [unit for unit, scale in scales.items() if STEP_S[0] <= step * scale <= STEP_S[1]]
        if units and (_called_time(name) or step != 1.0):  # a count of rows has no unit
            return Column(name=name, unit=units[0]), f"it increases, in steps of {step:g} {units[0] or 's'}{wrapped}"
    if useless:
        remedy = next((after for start, after in TIME_REMEDIES.items() if any(start in one for one in useless)), "")
        raise InputError(imported.name, f"lacks a time: {', '.join(useless[:3])}",
                         remedy or "sort the rows by time, one row a sample, each with its time")
    raise lacking(imported, "a time", {TIME: WORDS[TIME]})


def clock_of(imported: ImportedFile) -> tuple[dict[str, Column], dict[str, str]]:
    """The time's column and the reason for it, by its name in a run; both empty where all tables have their times."""
    if all(table.time_s is not None for table in imported.tables):
        return {}, {}
    column, why = time_column(imported)
    return {TIME: column}, {TIME: why}


def _called_time(name: str) -> bool:
    return says(BRACKETED.sub("", name).strip(), TIME_NAMES)


def _not_a_clock(values: FloatArray) -> str:
    """Why no run has this column (n,) for its time, in few words."""
    known = np.flatnonzero(np.isfinite(values))
    if known.size < 0.99 * values.size:
        return f"is blank in {values.size - known.size} of {values.size} rows"
    steps = np.diff(values[known])
    backwards = np.flatnonzero(steps < 0)
    usual, spread = float(np.median(values[known])), float(np.ptp(values[known]))
    if 0.0 < spread < usual and 2.0 * abs(float(steps.sum())) <= spread:
        return f"is the step from row to row, {usual:g} in the median"
    if backwards.size:
        return f"runs backwards in {backwards.size} of {values.size} rows, first in row {known[backwards[0] + 1] + 1}"
    still = f"stands still in {int((steps == 0).sum())} of {values.size} rows"
    digits = next((d for d in range(5, 12) if all(float(f"{v:.{d - 1}e}") == v for v in values[known[:1000]])), 0)
    few = digits and abs(values[known[0]]) >= 10.0**digits
    return f"{still}: its times have {digits} digits only" if few else still


def of_joints(angles: Sequence[str], others: Sequence[str]) -> dict[int, str]:
    """Joint from 0 -> its torque or command, by the words and numbers that a name shares with that of an angle."""
    from scipy.optimize import linear_sum_assignment  # 0.1 s to import, which a file in legid's own columns saves

    if not others:
        return {}
    shared = _shared(angles, others)
    order = -1e-3 * np.abs(np.subtract.outer(np.arange(len(others)), np.arange(len(angles))))
    rows, columns = linear_sum_assignment(-(shared + order))
    return {int(column): others[int(row)] for row, column in zip(rows, columns)}


def same_joint(angles: Sequence[str], torques: Sequence[str]) -> bool:
    """Whether two torque columns name one and the same joint: two readings of one torque."""
    shared = _shared(angles, torques)
    named = [int(np.argmax(row)) for row in shared if np.sum(row == row.max()) == 1 and row.max() > 0.0]
    return len(set(named)) < len(named)


def _shared(angles: Sequence[str], torques: Sequence[str]) -> FloatArray:
    """(torques, angles) words and numbers that two names share, and not all angles have."""
    words = [[set(re.findall(r"[a-z]+|\d+", name.lower())) for name in names] for names in (angles, torques)]
    common = set.intersection(*words[0]) if len(angles) > 1 else set()
    return np.array([[len((torque & angle) - common) for angle in words[0]] for torque in words[1]], dtype=float)
