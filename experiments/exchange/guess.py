"""A guess of what the columns of somebody else's file are: by their names first, then by gravity and by work.

Names say what kind of signal a column is. What units and signs it has is left to physics, as far as physics shows it:

- an accelerometer at rest reads gravity: its unit follows from the median of its length, the axis along the link is the
  one that carries gravity, and outwards is where gravity does not pull (`accel_y = -g` while the link hangs);
- the gyro turns about the axis that moves most; its unit and sign are those under which gravity along the link's side
  follows its integral (`accel_x = l q1dd + g sin q1`, with one lever arm l);
- encoder and torque: the pivot carries no motor and the knee's torque does the knee's work, so that the equation of
  motion, linear in its nine parameters (eq. (62) of Dolinsky and Celikovsky, IEEE TCST 26(4), 2018), leaves the
  smallest residual, and positive inertias, under the right unit and signs.

What physics does not show stays as the file has it: the torque's scale, which scales every parameter alike, and whether
the leg is seen from its left or its right, which nothing depends on.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from daq import Column, Dataset, FloatArray, InputError
from daq.runs import IMU
from experiments.exchange.column_map import TIME, apply_map
from experiments.exchange.foreign import Foreign
from experiments.exchange.guess_physics import Pose, find_imu, find_knee
from experiments.exchange.units import unit_in_name

PATTERNS = {
    "gyro": r"gyr|angular_?vel|omega|ang_?rate|\bw[xyz]\b|imu.*rate",
    "accel": r"acc|linear_accel|\ba[xyz]\b",
    "tau": r"torque|effort|\btau|_tau|trq|moment|\btq|current|iq_|_iq|\biq\b",
    "q1": r"\bq1|q_?1_|hip|pivot|joint_?1\b|shoulder|joint_?0\b",
    "q2": r"\bq2|q_?2_|knee|joint_?2\b|elbow|pos|angle|enc|theta|\bq\b",
}
"""Kind of signal -> how columns that hold it are called; of several kinds the first one counts."""
NOT_MEASURED = r"cmd|command|set_?point|desired|target|ref|goal|input_"
NOT_AN_ANGLE = r"vel|speed|rate|dot|temp|volt|setpoint|err|status|fault|acc"
TIME_NAMES = r"^_*(time|t|timestamp|stamp|sec|seconds|zeit|clock|millis|micros|time_.*|t_.*|.*timestamp.*|.*time)$"
STEP_S = (0.0002, 0.1)
"""Steps between which a log of a leg lies: they tell seconds from milliseconds."""
AXIS = re.compile(r"[^a-zA-Z0-9]?([xyz])(?:[\s\[(_].*)?$", re.IGNORECASE)


@dataclass(frozen=True)
class Guess:
    """What was found, with the reasons."""

    columns: dict[str, Column]
    notes: dict[str, str]
    """Why, by column of the contract."""
    warnings: list[str]
    run: Dataset
    """The file as it reads by the guess."""
    curves: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    """Title -> what was measured and what physics makes of the other columns, both (n,) on the grid of `run`."""


def guess_map(foreign: Foreign, gravity_mps2: float = 9.81) -> Guess:
    """Columns of `foreign` with units and signs, for a leg hanging from its pivot. Raises `InputError`."""
    columns, notes = _by_name(foreign)
    if "q2_rad" not in columns or "tau2_nm" not in columns:
        lacking = [name for name in ("q2_rad", "tau2_nm") if name not in columns]
        raise InputError(foreign.name, f"has no column that looks like {' or '.join(lacking)}: "
                                       + ", ".join(foreign.names[:20]), "write the map by hand, see docs/exchange.md")
    triads = {kind: _triad(foreign, kind) for kind in ("gyro", "accel")}
    raw = apply_map(foreign, {**columns, **{f"q{k + 3}_rad": Column(name=name) for k, name in enumerate(
        [*triads["gyro"], *triads["accel"]])}})
    warnings: list[str] = []
    pose: Pose | None = None
    curves: dict[str, tuple[FloatArray, FloatArray]] = {}
    read = {name: raw[f"q{k + 3}_rad"] for k, name in enumerate([*triads["gyro"], *triads["accel"]])}
    if triads["gyro"] and len(triads["accel"]) >= 2:
        imu = find_imu(raw.rate_hz, {n: read[n] for n in triads["gyro"]}, {n: read[n] for n in triads["accel"]},
                       gravity_mps2)
        columns |= imu.columns
        notes |= imu.notes
        warnings += imu.warnings
        pose = imu.pose
        curves["accel_x_mps2: read, and as gyro and gravity make it [m/s²]"] = imu.check
    elif "q1_rad" not in columns:
        raise InputError(foreign.name, "has neither a gyro and an accelerometer nor an angle of the pivot",
                         "write the map by hand, see docs/exchange.md")
    knee = find_knee(raw, columns, pose, gravity_mps2)
    columns |= knee.columns
    notes |= {name: "\n".join(filter(None, (notes.get(name, ""), text))) for name, text in knee.notes.items()}
    curves["tau2_nm: read, and as the motion makes it [N m]"] = knee.check
    warnings += knee.warnings
    if pose is not None and "q1_rad" in columns and not columns["q1_rad"].unit:
        del columns["q1_rad"]  # a benchmark only: without a unit it is of no use
        notes.pop("q1_rad", None)
    order = [TIME, *IMU, "q1_rad", "q2_rad", "tau2_nm", "tau2_cmd_nm"]
    columns = {name: columns[name] for name in order if name in columns}
    return Guess(columns, notes, warnings, apply_map(foreign, columns), curves)


def _by_name(foreign: Foreign) -> tuple[dict[str, Column], dict[str, str]]:
    """Time, angles and torques, with the units that names state."""
    columns, notes = {}, {}
    found = {"q1_rad": _best(foreign, "q1"), "q2_rad": _best(foreign, "q2"), "tau2_nm": _best(foreign, "tau"),
             "tau2_cmd_nm": _best(foreign, "tau", measured=False)}
    for name, theirs in found.items():
        if theirs:
            unit = unit_in_name(theirs, name)
            columns[name] = Column(name=theirs, unit=unit)
            notes[name] = "by its name" + (f", which says {unit}" if unit else "")
    if any(table.time_s is None for table in foreign.tables):
        columns[TIME], notes[TIME] = _time(foreign)
    return columns, notes


def _kind(name: str) -> str:
    return next((kind for kind, pattern in PATTERNS.items() if re.search(pattern, name, re.IGNORECASE)), "")


def _best(foreign: Foreign, kind: str, measured: bool = True) -> str:
    """The column that is most likely of this kind, by its name; empty where none is."""
    fitting: list[tuple[bool, bool, int, str]] = []
    for name in foreign.names:
        commanded = bool(re.search(NOT_MEASURED, name, re.IGNORECASE))
        if _kind(name) != kind or commanded == measured or re.match(TIME_NAMES, name, re.IGNORECASE):
            continue
        if kind in ("q1", "q2") and re.search(NOT_AN_ANGLE, name, re.IGNORECASE):
            continue
        values = foreign.table_of(name).columns[name]
        known = values[np.isfinite(values)]
        if known.size > 2 and np.ptp(known) > 0.0:
            knee = bool(re.search("knee|2", name, re.IGNORECASE))
            current = bool(re.search("current|iq", name, re.IGNORECASE))
            fitting.append((knee, not current, -len(fitting), name))
    return max(fitting)[-1] if fitting else ""


def _triad(foreign: Foreign, kind: str) -> list[str]:
    """Columns of a sensor with up to three axes."""
    names = [name for name in foreign.names if _kind(name) == kind and "bias" not in name.lower()]
    axes = [name for name in names if AXIS.search(name)]
    return (axes or names)[:3]


def _time(foreign: Foreign) -> tuple[Column, str]:
    """The column that increases and is called so; its unit by its name, else by the step."""
    for name in sorted(foreign.names, key=lambda n: not re.match(TIME_NAMES, n, re.IGNORECASE)):
        values = foreign.table_of(name).columns[name]
        steps = np.diff(values)
        if not (np.isfinite(values).all() and (steps >= 0).mean() > 0.99 and np.median(steps) > 0):
            continue
        unit = unit_in_name(name, TIME)
        if unit:
            return Column(name=name, unit=unit), f"by its name, which says {unit}"
        step = float(np.median(steps[steps > 0]))
        scales = {"": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
        units = [unit for unit, scale in scales.items() if STEP_S[0] <= step * scale <= STEP_S[1]]
        if units:
            return Column(name=name, unit=units[0]), f"it increases, in steps of {step:g} {units[0] or 's'}"
    raise InputError(foreign.name, "has no column that looks like time: " + ", ".join(foreign.names[:20]),
                     "write the map by hand, see docs/exchange.md")
