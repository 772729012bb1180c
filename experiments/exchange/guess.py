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
from dataclasses import dataclass, field, replace

import numpy as np

from daq import Column, Dataset, FloatArray, InputError
from daq.runs import IMU, unwrapped_counter
from experiments.exchange.column_map import TIME, apply_map
from experiments.exchange.guess_chain import driven_joints, find_chain, same_joint
from experiments.exchange.guess_joint import find_joint
from experiments.exchange.guess_physics import Pose, find_imu
from experiments.exchange.guess_rivals import Rivals, best_knee
from experiments.exchange.guess_walker import find_walker, walker_or_chain
from experiments.exchange.imported import ImportedFile
from experiments.exchange.units import BRACKETED, factor, unit_in_name

PATTERNS = {
    "gyro": r"gyr|angular_?vel|omega|ang_?rate|(?<![a-z])[gw][xyz](?![a-z])|imu.*rate",
    "accel": r"acc|linear_accel|(?<![a-z])a[xyz](?![a-z])",
    "tau": r"torque|effort|\btau|_tau|trq|moment|\btq|current|strom|iq_|_iq|\biq\b",
    "q1": r"\bq1|q_?1_|hip|pivot|joint_?1\b|shoulder|joint_?0\b",
    "q2": r"\bq_?[2-9]|q_?[2-9]_|knee|knie|joint_?[2-9]\b|ankle|wrist|elbow|torso|trunk|pos|angle|winkel"
          r"|enc(?![eyh])|theta|\bq\b|observation\.state",
}
"""Kind of signal -> how columns that hold it are called; of several kinds the first one counts."""
NOT_MEASURED = r"cmd|command|set_?point|desired|(?<![a-z])des(?![a-z])|target|ref|goal|input_|clip|(?<![a-z])action"
WORDS = {"gyro": "gyro, omega, wz or gz", "accel": "acc, ax", "tau2_nm": "torque, effort, tau, current or iq",
         "q2_rad": "knee, q2, angle, position or encoder", "q1_rad": "hip, q1 or pivot", TIME: "time, t or stamp"}
"""What a person is told to call them."""
MOST_LINKS = 5
"""Of a chain whose columns are guessed: signs are tried in all combinations."""
MOST_RIVALS = 4
"""Columns that are tried in addition to the most likely one."""
TORSO = r"torso|trunk"
NOT_AN_ANGLE = r"vel|speed|rate|dot|temp|volt|setpoint|err|status|fault|acc|imu|force|wrench|torque"
WRENCH = r"wrench|netft"
"""A sensor of six axes, none of which is a joint's torque by its name."""
MAYBE_TORQUE = r"^[^a-z]*(u|input|control)[^a-z]*$"
LEAST = 1e-300
"""Smaller numbers are memory that nobody wrote to, read as a double."""
MADE_OF_OTHERS = 1e-4
"""An angle that is a sum of others but for this share of its spread is no joint of its own."""
TIME_NAMES = (r"^_*(time|t|timestamp|stamp|sec|seconds|zeit(?:stempel)?|clock|millis|micros|time_.*|t_.*|"
              r".*timestamp.*|.*time)$")
STEP_S = (0.0002, 0.1)
"""Steps between which a log of a leg lies: they tell seconds from milliseconds."""
UNNAMED = re.compile(r"column \d+")
"""What a reader calls a column of a table without a header."""
TIME_REMEDIES = {"digits only": "export the times with more digits, or leave the column out and give --rate HZ",
                 "stands still": "export times of a finer resolution, or give --rate HZ for rows at one rate"}
"""What a column of times lacks -> the remedy."""
AXIS = re.compile(r"[^a-zA-Z0-9]?([xyz])(?:[\s\[(_].*)?$", re.IGNORECASE)


@dataclass(frozen=True)
class Guess:
    """Guessed map, with the reasons."""

    columns: dict[str, Column]
    notes: dict[str, str]
    """Why, by column of the contract."""
    warnings: list[str]
    unexplained: list[str]
    """What no unit and sign makes fit; with any, the guess is not to be used as it is."""
    run: Dataset
    """The file as it reads by the guess."""
    curves: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    """Title -> what was measured and what physics makes of the other columns, both (n,) on the grid of `run`."""


def guess_map(imported: ImportedFile, gravity_mps2: float = 9.81, rate_hz: float | None = None) -> Guess:
    """Columns of `imported` with units and signs, for a hanging leg, a single joint, a chain or a walker.

    A file with one angle, one torque or none and no gyro or accelerometer is a single joint's. One with three angles or
    more, or with two torques, is a chain's whose joints all have encoders. Three angles and two torques may be a
    walker's, which touchdowns show. A file without times has `rate_hz` rows a second. Raises `InputError`.
    """
    if rate_hz is not None:
        imported = _timed(imported, rate_hz)
    columns, notes, rivals = _by_name(imported)
    if _is_joint(imported):
        return _guess_joint(imported, columns, notes)
    if _is_chain(imported):
        return _guess_chain(imported, columns, notes, gravity_mps2)
    if "q2_rad" not in columns or "tau2_nm" not in columns:
        lacking = [name for name in ("q2_rad", "tau2_nm") if name not in columns]
        kinds = {"q2_rad": "q2", "tau2_nm": "tau"}
        raise _lacking(imported, " and ".join(lacking), {kinds[name]: WORDS[name] for name in lacking})
    triads = {kind: _triad(imported, kind) for kind in ("gyro", "accel")}
    axes = [Column(name=name) for name in (*triads["gyro"], *triads["accel"])]
    torques = [Column(name=name, unit=unit_in_name(name, "tau2_nm")) for name in _fitting(imported, "tau", True)
               if name != columns["tau2_nm"].name][:MOST_RIVALS]
    plain = [*axes, *rivals, *(Column(name=column.name) for column in torques)]
    spare = {column.name: f"q{k + 3}_rad" for k, column in enumerate(plain)}
    raw = apply_map(imported, {**columns, **{spare[column.name]: column for column in plain}})
    warnings, unexplained = [], []
    pose: Pose | None = None
    curves: dict[str, tuple[FloatArray, FloatArray]] = {}
    read = {column.name: raw[spare[column.name]] for column in axes}
    if triads["gyro"] and len(triads["accel"]) >= 2:
        imu = find_imu(raw.rate_hz, {n: read[n] for n in triads["gyro"]}, {n: read[n] for n in triads["accel"]},
                       gravity_mps2)
        columns |= imu.columns
        notes |= imu.notes
        warnings += imu.warnings
        unexplained += imu.unexplained
        pose = imu.pose
        curves["accel_x_mps2: measured, and computed from gyro and gravity [m/s²]"] = imu.check
    elif "q1_rad" not in columns:
        raise _lacking(imported, "a gyro and two axes of an accelerometer, or an angle of the pivot",
                       {kind: WORDS[kind] for kind in ("gyro", "accel")} | {"q1": WORDS["q1_rad"]})
    knee, why = best_knee(raw, columns, Rivals(rivals, torques, spare), pose, gravity_mps2)
    notes |= why
    columns |= knee.columns
    notes |= {name: "\n".join(filter(None, (notes.get(name, ""), text))) for name, text in knee.notes.items()}
    curves["tau2_nm: measured, and computed from the motion [N m]"] = knee.check
    warnings += knee.warnings
    unexplained += knee.unexplained
    if pose is not None and "q1_rad" in columns and not columns["q1_rad"].unit:
        del columns["q1_rad"]  # a benchmark only: without a unit it is of no use
        notes.pop("q1_rad", None)
    order = [TIME, *IMU, "q1_rad", "q2_rad", "tau2_nm", "tau2_cmd_nm"]
    columns = {name: columns[name] for name in order if name in columns}
    return Guess(columns, notes, warnings, unexplained, apply_map(imported, columns), curves)


def _timed(imported: ImportedFile, rate_hz: float) -> ImportedFile:
    """`imported` with `rate_hz` rows a second in each table without a column of times."""
    try:
        if all(table.time_s is None for table in imported.tables):
            _time(imported)
            return imported
    except InputError:
        pass
    return replace(imported, tables=tuple(
        table if table.time_s is not None else
        table._replace(time_s=np.arange(next(iter(table.columns.values())).size) / rate_hz)
        for table in imported.tables if table.columns))


def _is_joint(imported: ImportedFile) -> bool:
    """One measured angle, at most one measured torque, and no sensor of a leg: neither read nor left out."""
    angles = len(_fitting(imported, "q1", True)) + len(_fitting(imported, "q2", True))
    torques = len(_fitting(imported, "tau", True)) if _has(imported, "tau") else 1
    return angles == 1 and torques == 1 and not _has(imported, "gyro", "accel")


def _is_chain(imported: ImportedFile) -> bool:
    """Angles of three joints or more, or torques of two, and no gyro or accelerometer, neither read nor left out, but
    a torso's."""
    angles, torques = _angles(imported), _fitting(imported, "tau", True)
    some = 0 < len(torques) <= len(angles) <= MOST_LINKS and (
        len(angles) > 2 or (len(torques) == 2 and not same_joint(angles, torques)))
    some |= 2 <= len(angles) <= MOST_LINKS and not _has(imported, "tau")
    return some and (not _has(imported, "gyro", "accel") or bool(re.search(TORSO, " ".join(angles), re.IGNORECASE)))


def _has(imported: ImportedFile, *kinds: str) -> bool:
    """Whether a column is of one of these kinds by its name, read or left out."""
    return any(_kind(name) in kinds for name in [*imported.names, *imported.left_out])


def _angles(imported: ImportedFile) -> list[str]:
    """Columns that are measured angles by their names, without those that are sums of others: by their numbers where
    each has one, else as in the file."""
    names = sorted([*_fitting(imported, "q1", True), *_fitting(imported, "q2", True)], key=imported.names.index)
    own = _independent(imported, names, driven_joints(names, _fitting(imported, "tau", True)).values())
    numbers = [re.findall(r"\d+", name) for name in own]
    return sorted(own, key=lambda name: int(re.findall(r"\d+", name)[-1])) if all(numbers) else own


def _independent(imported: ImportedFile, names: list[str], driven: Collection[int]) -> list[str]:
    """Those of `names` that are no linear combination of others; angles of `driven` joints are kept before others."""
    values = [imported.table_of(name).columns[name] for name in names]
    if len({x.size for x in values}) != 1:  # signals with times of their own
        return names
    known = np.isfinite(np.array(values)).all(axis=0)
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
                 ) -> Guess:
    """The guess for a chain of joints, each with an encoder, or for a walker."""
    angles = _angles(imported)
    driven = driven_joints(angles, sorted(_fitting(imported, "tau", True), key=imported.names.index))
    time = {TIME: columns[TIME]} if TIME in columns else {}

    def put(order: Sequence[int]) -> tuple[dict[str, Column], Dataset]:
        theirs = {f"q{k}_rad": Column(name=angles[j], unit=unit_in_name(angles[j], "q2_rad"))
                  for k, j in enumerate(order, 1)}
        theirs |= {f"tau{order.index(j) + 1}_nm": Column(name=name, unit=unit_in_name(name, "tau2_nm"))
                   for name, j in driven.items()}
        return theirs, apply_map(imported, time | theirs)

    theirs, raw = put(range(len(angles)))
    wrenches = [] if driven else _wrenches(imported)
    if wrenches:
        unknown = {name: "NOT KNOWN: no column is known to be its torque" for name in theirs if name != TIME}
        return Guess(theirs | time, unknown, [], wrenches, raw)
    found = find_chain(raw, theirs, gravity_mps2)
    if len(angles) == 3 and len(driven) == 2:
        theirs, raw = put(sorted(range(3), key=lambda j: (j in driven.values(), j)))
        found = walker_or_chain(find_walker(raw, theirs, gravity_mps2), found)
    theirs = found.columns | time
    reasons = {TIME: notes[TIME]} if TIME in notes else {}
    last = max((name for name in theirs if name.startswith("tau")), default="")
    what = f"{last}: measured, and computed from the motion [N m]" if last else \
        "acceleration: measured, and computed from gravity and friction [rad/s²]"
    maybe = [] if driven else _maybe_torques(imported)
    return Guess(theirs, reasons | found.notes, [*found.warnings, *maybe], found.unexplained,
                 apply_map(imported, theirs), {what: found.check})


def _maybe_torques(imported: ImportedFile) -> list[str]:
    """A warning for each column that may be a torque, though its name does not say which."""
    return [f"{name!r} may be a torque: name the joint that it drives by [columns.tau1_nm] or [columns.tau2_nm]"
            for name in imported.names if re.match(MAYBE_TORQUE, name, re.IGNORECASE)
            and _changes(imported.table_of(name).columns[name])]


def _wrenches(imported: ImportedFile) -> list[str]:
    """One line where a sensor of six axes may hold a joint's torque."""
    axes = [name for name in imported.names if re.search(WRENCH, name, re.IGNORECASE)]
    moments = [name for name in axes if re.search("torque|moment|/m[xyz]", name, re.IGNORECASE)]
    if not axes:
        return []
    return [f"{', '.join(map(repr, moments or axes))}: a sensor of six axes, and no name says which of them is the "
            "torque of which joint. Name it by [columns.tau1_nm], with sign = -1 where it is the reaction"]


def _guess_joint(imported: ImportedFile, columns: dict[str, Column], notes: dict[str, str]) -> Guess:
    """The guess for one joint from the columns of `_by_name`, which are named as a leg's."""
    theirs = {"q1_rad": columns.get("q1_rad") or columns["q2_rad"]}
    theirs |= {"tau1_nm": columns["tau2_nm"]} if "tau2_nm" in columns else {}
    theirs |= {TIME: columns[TIME]} if TIME in columns else {}
    joint = find_joint(apply_map(imported, theirs), theirs)
    theirs |= joint.columns
    reasons = {TIME: notes[TIME]} if TIME in notes else {}
    what = "tau1_nm: measured, and computed from the motion [N m]" if "tau1_nm" in theirs else \
        "acceleration: measured, and computed from gravity and friction [rad/s²]"
    curves = {what: joint.check}
    return Guess(theirs, reasons | joint.notes, joint.warnings, joint.unexplained, apply_map(imported, theirs), curves)


def _by_name(imported: ImportedFile) -> tuple[dict[str, Column], dict[str, str], list[Column]]:
    """Time, angles and torques, with the units that names state; others that are the knee's angle by their names."""
    columns, notes = {}, {}
    rivals: list[Column] = []
    kinds = {"q1_rad": ("q1", True), "q2_rad": ("q2", True), "tau2_nm": ("tau", True), "tau2_cmd_nm": ("tau", False)}
    for name, kind in kinds.items():
        fitting = _fitting(imported, *kind)
        if fitting:
            theirs, *others = fitting
            unit = unit_in_name(theirs, name)
            columns[name] = Column(name=theirs, unit=unit)
            notes[name] = "by its name" + (f", which says {unit}" if unit else "")
            if name == "q2_rad":
                rivals = [Column(name=other, unit=unit_in_name(other, name)) for other in others[:MOST_RIVALS]]
            elif others:
                notes[name] += f" (as {', '.join(map(repr, others[:MOST_RIVALS]))} could be)"
    if any(table.time_s is None for table in imported.tables):
        columns[TIME], notes[TIME] = _time(imported)
    return columns, notes, rivals


def _kind(name: str) -> str:
    if re.search(WRENCH, name, re.IGNORECASE):
        return ""
    return next((kind for kind, pattern in PATTERNS.items() if re.search(pattern, name, re.IGNORECASE)), "")


def _lacking(imported: ImportedFile, what: str, words: Mapping[str, str]) -> InputError:
    """The error for a file without `what`; `words`: kind of signal -> how such columns are called.

    A column that is called so and cannot be used is named with the reason."""
    useless = [f"{name!r} {why}" for name, why in imported.left_out.items() if _kind(name) in words]
    for name in imported.names:
        values = imported.table_of(name).columns[name]
        if _kind(name) in words and not _changes(values):
            useless.append(f"{name!r} {_unchanging(values)}")
    if useless:
        return InputError(imported.name, f"lacks {what}: {', '.join(useless[:6])}",
                          "correct those cells, or map another column by hand: see docs/exchange.md")
    if imported.names and all(map(UNNAMED.fullmatch, imported.names)):
        return InputError(imported.name, f"has no header line: its {len(imported.names)} columns have no names",
                          'write the map by hand, name = "column 2" for the second: see docs/exchange.md')
    names = ", ".join(map(repr, imported.names[:20]))
    return InputError(imported.name, f"lacks {what} by the names of its columns: {names}",
                      f"name it by a word such as {'; '.join(words.values())}, or write the map by hand, see "
                      "docs/exchange.md")


def _changes(values: FloatArray) -> bool:
    known = values[np.isfinite(values)]
    return bool(known.size > 2 and np.ptp(known) > LEAST)


def _unchanging(values: FloatArray) -> str:
    """Why a column (n,) that does not change is of no use, in few words."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "is blank"
    return "never changes" if np.ptp(known) == 0.0 else f"holds no torque (all readings are below {LEAST:g})"


def _fitting(imported: ImportedFile, kind: str, measured: bool) -> list[str]:
    """The columns that may be of this kind by their names, the most likely first."""
    fitting: list[tuple[bool, bool, int, str]] = []
    for name in imported.names:
        commanded = bool(re.search(NOT_MEASURED, name, re.IGNORECASE))
        if _kind(name) != kind or commanded == measured or re.match(TIME_NAMES, name, re.IGNORECASE):
            continue
        if kind in ("q1", "q2") and re.search(NOT_AN_ANGLE, name, re.IGNORECASE):
            continue
        if _changes(imported.table_of(name).columns[name]):
            knee = bool(re.search("knee|knie|2", name, re.IGNORECASE))
            current = bool(re.search("current|strom|iq", name, re.IGNORECASE))
            fitting.append((knee, not current, -len(fitting), name))
    return [name for *_, name in sorted(fitting, reverse=True)]


def _triad(imported: ImportedFile, kind: str) -> list[str]:
    """Columns of a sensor with up to three axes."""
    names = [name for name in imported.names if _kind(name) == kind and "bias" not in name.lower()
             and np.isfinite(imported.table_of(name).columns[name]).sum() > 2]
    axes = [name for name in names if AXIS.search(name)]
    return (axes or names)[:3]


def _time(imported: ImportedFile) -> tuple[Column, str]:
    """The column that increases and is called so; its unit by its name, else by the step."""
    useless = [f"{name!r} {why}" for name, why in imported.left_out.items() if _called_time(name)]
    for name in sorted(imported.names, key=lambda n: not _called_time(n)):
        values = imported.table_of(name).columns[name]
        known = np.flatnonzero(np.isfinite(values))
        wraps = unwrapped_counter(values[known], factor(unit_in_name(name, TIME), TIME, name))
        steps = np.diff(values[known] if wraps is None else wraps.time)
        if known.size < 0.99 * values.size or (steps >= 0).mean() <= 0.99 or np.median(steps) <= 0:
            if _called_time(name):
                useless.append(f"{name!r} {_not_a_clock(values if wraps is None else wraps.time)}")
            continue
        unit = unit_in_name(name, TIME)
        if unit:
            return Column(name=name, unit=unit), f"by its name, which says {unit}"
        step = float(np.median(steps[steps > 0]))
        scales = {"": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
        units = [unit for unit, scale in scales.items() if STEP_S[0] <= step * scale <= STEP_S[1]]
        if units and (_called_time(name) or step != 1.0):  # a count of rows has no unit
            return Column(name=name, unit=units[0]), f"it increases, in steps of {step:g} {units[0] or 's'}"
    if useless:
        remedy = next((after for start, after in TIME_REMEDIES.items() if any(start in one for one in useless)), "")
        raise InputError(imported.name, f"lacks a time: {', '.join(useless[:3])}",
                         remedy or "sort the rows by time, one row a sample, each with its time")
    raise _lacking(imported, "a time", {TIME: WORDS[TIME]})


def _called_time(name: str) -> bool:
    return bool(re.match(TIME_NAMES, BRACKETED.sub("", name).strip(), re.IGNORECASE))


def _not_a_clock(values: FloatArray) -> str:
    """Why no run has this column (n,) for its time, in few words."""
    known = np.flatnonzero(np.isfinite(values))
    if known.size < 0.99 * values.size:
        return f"is blank in {values.size - known.size} of {values.size} rows"
    steps = np.diff(values[known])
    backwards = np.flatnonzero(steps < 0)
    if backwards.size:
        return f"runs backwards in {backwards.size} of {values.size} rows, first in row {known[backwards[0] + 1] + 1}"
    still = f"stands still in {int((steps == 0).sum())} of {values.size} rows"
    digits = next((d for d in range(5, 12) if all(float(f"{v:.{d - 1}e}") == v for v in values[known[:1000]])), 0)
    few = digits and abs(values[known[0]]) >= 10.0**digits
    return f"{still}: its times have {digits} digits only" if few else still
