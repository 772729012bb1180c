"""Recordings of other projects whose units are documented: PACE, LeRobot, BAM, and logs of servo registers.

| layout | known by | angles |
| --- | --- | --- |
| PACE (`leggedrobotics/pace-sim2real`, scripts/pace/data_collection.py) | `dof_pos`, `des_dof_pos` | rad |
| LeRobot (`huggingface/lerobot`, robots/so_follower) | `observation.state`, `action` | degrees or per cent |
| BAM (`Rhoban/bam`, bam/dynamixel/record.py) | `entries` with `position`, `goal_position` | rad, 0 hanging |
| registers | see `registers` | counts |

LeRobot's joints have their names in meta/info.json. Per cent are of the calibrated range; no file says which of both.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq import Column, InputError, read_bytes
from daq.runs import ENABLED, LOAD_COLUMN
from experiments.exchange.guess_names import says
from experiments.exchange.imported import ImportedFile, Table
from experiments.exchange.registers import PWM_FULL, angle_register, known, maker, motor_registers
from experiments.exchange.units import unit_in_name

STATE, ACTION, EPISODE = "observation.state", "action", "episode_index"
ROBOT = "lerobot.robot"
"""Fact of a LeRobot file: the robot's type, empty where no file states it."""
UNIT = "unit of "
"""Start of the fact that names the unit of a column by its numbers."""
LOADS = {"observation.effort": "observation.load_effort", "observation.current": "observation.load_current"}
"""Feature of a data set without a unit -> its columns' name here, which no guess takes for a torque"""
BAM_ANGLE, BAM_GOAL, BAM_ON = "entries.position", "entries.goal_position", "entries.torque_enable"
BAM_LOAD, BAM_VOLTS = "entries.load", "entries.input_volts"
SIGNAL = re.compile(r"\.(pos|position|effort|eff|torque|current|load)$")
PACE = re.compile(r"(des_)?dof_pos\b")
HOBBY = r"so_?10\d|so_follower|koch|omx|lekiwi|moss"
"""Types of robots of Dynamixel and Feetech servos (huggingface/lerobot, robots/)."""
RANGE = 100.0
"""Per cent of the calibrated range, to either side."""
MOST_INFO, MOST_EPISODES = 1 << 20, 10_000
BAM_DUTY = {"xl330": 4096 / (2 * np.pi) / (256 * PWM_FULL), "mx106": 0.158, "mx64": 0.158, "xl320": 0.05048199,
            "sts3215": 0.166}
"""Motor -> duty per rad of error and count of the register kp (bam/dynamixel/actuator.py, bam/feetech/actuator.py)."""


def with_layout(imported: ImportedFile, path: Path) -> ImportedFile:
    """A LeRobot file with the names of its joints, each episode a run of its own with its times; others as they are.

    A recording of BAM has no command where its motor is off. Raises `InputError` for an info.json that cannot be read.
    """
    if BAM_GOAL in imported.names:
        return replace(imported, tables=tuple(table if not {BAM_GOAL, BAM_ON} <= table.columns.keys() else Table({
            **table.columns, BAM_GOAL: np.where(table.columns[BAM_ON] > 0.0, table.columns[BAM_GOAL], np.nan)})
            for table in imported.tables))
    if not any(name.startswith(f"{STATE}[") for name in imported.names) or "timestamp" not in imported.names:
        return imported
    names, robot = _robot_of(path)
    table = imported.table_of("timestamp")
    kinds = STATE, ACTION, *LOADS
    called = {name: _called(name, names) for name in table.columns if name.partition("[")[0] in kinds}
    if not called:
        return imported
    episodes = table.columns.get(EPISODE, np.zeros(table.columns["timestamp"].size))
    numbers = np.unique(episodes[np.isfinite(episodes)])
    if not 0 < numbers.size <= MOST_EPISODES:
        return imported
    tables = []
    for k, number in enumerate(numbers, 1):
        rows, cell = episodes == number, f"{{{k}}}" if numbers.size > 1 else ""
        tables.append(Table({f"{new}{cell}": table.columns[old][rows] for old, new in called.items()},
                            table.columns["timestamp"][rows]))
    return replace(imported, tables=tuple(tables), facts={**imported.facts, ROBOT: robot})


def _called(name: str, names: Mapping[str, list[str]]) -> str:
    kind, _, number = name.rstrip("]").partition("[")
    joints = names.get(kind, [])
    joint = joints[int(number) - 1] if int(number) <= len(joints) else ""
    if kind in LOADS:
        kind, joint = LOADS[kind], SIGNAL.sub("", joint)
    return f"{kind}.{joint}" if joint else f"{kind}[{number}]"


def _robot_of(path: Path) -> tuple[dict[str, list[str]], str]:
    """Names of the numbers in `action` and `observation.state`, and the robot's type, by the info.json of the data set
    that `path` is in."""
    info = next((folder / "meta" / "info.json" for folder in path.resolve().parents[:4]
                 if (folder / "meta" / "info.json").is_file()), None)
    if info is None:
        return {}, ""
    try:
        content = json.loads(read_bytes(info, MOST_INFO))
        features, robot = content["features"], str(content.get("robot_type") or "")[:40]
        found = {kind: features.get(kind, {}).get("names") or [] for kind in (ACTION, STATE, *LOADS)}
        flat = {kind: next(iter(some.values())) if isinstance(some, dict) else some for kind, some in found.items()}
    except (ValueError, KeyError, TypeError, AttributeError, StopIteration, OSError, RecursionError):
        raise InputError(str(info), "is no info.json of a LeRobot data set", "give the data set as it was written"
                         ) from None
    return {kind: [str(one) for one in some] for kind, some in flat.items() if isinstance(some, list)}, robot


def stated(imported: ImportedFile, name: str, contract: str) -> Column:
    """Column `name` as its layout means it, in the units of the layout; else with the unit that its name states, or the
    turn by which it wraps."""
    if ROBOT in imported.facts:
        return Column(name=name, unit="deg" if _counts_degrees(imported) else "")
    if PACE.match(name) or name in (BAM_ANGLE, BAM_GOAL):
        return Column(name=name, unit="rad")
    unit = unit_in_name(name, contract) or imported.facts.get(f"{UNIT}{name}", "")
    return angle_register(imported, name) or Column(name=name, unit=unit)


def loads_of(imported: ImportedFile, angles: Mapping[str, Column]) -> dict[str, Column]:
    """Columns `load1_raw`, ... of the joints of `angles` (`q1_rad`, ...) in a LeRobot file, by their names."""
    joints: dict[str, str] = {}
    for name in imported.names:
        kind, joint = _split(name)
        if kind in LOADS.values():
            joints.setdefault(joint, name)
    found = {}
    for name, column in angles.items():
        kind, joint = _split(column.name)
        if kind == STATE and joint in joints:
            found[f"load{name[1:].removesuffix('_rad')}_raw"] = Column(name=joints[joint])
    return found


def _split(name: str) -> tuple[str, str]:
    """Feature and joint of a column: ("observation.state", "elbow_flex") of observation.state.elbow_flex.pos."""
    kind = next((one for one in (STATE, *LOADS.values()) if re.match(rf"{re.escape(one)}[.\[]", name)), "")
    return kind, SIGNAL.sub("", name[len(kind) :])


def motor_columns(imported: ImportedFile) -> dict[str, Column]:
    """The columns `duty`, `volts` and `torque_enable` of a layout, or of them what it has; empty for other files."""
    if BAM_LOAD not in imported.names or BAM_VOLTS not in imported.names:
        return motor_registers(imported)
    on = imported.values(BAM_ON) if BAM_ON in imported.names else np.ones(1)
    columns = {"volts": Column(name=BAM_VOLTS)} | ({ENABLED: Column(name=BAM_ON)} if np.ptp(on) > 0.0 else {})
    load = known(imported, BAM_LOAD)
    if not np.ptp(load) or "xl330" not in imported.facts.get("bam.motor", ""):
        return columns  # of other servos BAM does not say what its load is
    counts = np.abs(load).max() > 1.0
    return columns | {"duty": Column(name=BAM_LOAD, scale=1.0 / PWM_FULL, bits=16) if counts else Column(name=BAM_LOAD)}


def without_sign(imported: ImportedFile, name: str) -> bool:
    """Whether a column of BAM's layout is a magnitude, as the torque and the current of kscalelabs/sysid are."""
    values = imported.values(name)
    return BAM_ANGLE in imported.names and bool(np.nanmin(values) >= 0.0)


def layout_warnings(imported: ImportedFile, used: Mapping[str, Column]) -> list[str]:
    """Sentences on what the files of a layout leave open."""
    if ROBOT in imported.facts:
        loads = {name: column for name, column in used.items() if LOAD_COLUMN.fullmatch(name)}
        return [_lerobot(imported, used), *([_unit_of_loads(loads)] if loads else [])]
    if BAM_ANGLE in imported.names:
        return _bam(imported.facts, "duty" in used)
    if any(column.scale == 1.0 / 4096 for column in used.values()):
        who = maker(imported)
        return [f"counts of a {who or 'Dynamixel or Feetech'} are read as 4096 a turn with 0 at 2048: correct offset "
                "where the link hangs at another count" + ("" if who else "; without a load or PWM the names do not "
                "tell whose they are, nor the unit of a current")]
    return []


def _unit_of_loads(loads: Mapping[str, Column]) -> str:
    first, column = next(iter(loads.items()))
    torque = f"tau{first.removeprefix('load').removesuffix('_raw')}_nm"
    return (f"LeRobot's files do not say the unit of {column.name!r}: it is kept as {', '.join(loads)}, and nothing "
            f"reads it. What is it in? Where you know, call [columns.{first}] {torque} in columns.toml, with scale in "
            "N m a unit, gear included")


def _counts_degrees(imported: ImportedFile) -> bool:
    """The robot is one of hobby servos, whose angles LeRobot gives in degrees or in per cent; or nothing is known."""
    robot = imported.facts.get(ROBOT, "")
    return not robot or says(robot, HOBBY)


def _lerobot(imported: ImportedFile, used: Mapping[str, Column]) -> str:
    if not _counts_degrees(imported):
        return (f"LeRobot's files do not say the unit of the angles of {imported.facts[ROBOT]!r}, nor where "
                "their zero is: set unit and offset by the robot's description")
    bare = [column.name.partition("{")[0] for name, column in used.items() if name.endswith("_rad")]
    far = max((float(np.abs(values[np.isfinite(values)]).max(initial=0.0)) for table in imported.tables
               for name, values in table.columns.items() if name.partition("{")[0] in bare), default=0.0)
    if far > RANGE:
        return (f"LeRobot's angles go to {far:.0f}, so they are in degrees; their zero is the middle of the calibrated "
                "range, not where a link hangs: set offset")
    clipped = "one ends at 100, as per cent do; " if far == RANGE else ""
    return ("LeRobot's files do not say whether .pos is in degrees or in per cent of the calibrated range (use_degrees "
            f"of the robot): {clipped}degrees are taken. For per cent set scale to the range in degrees / 200, by the "
            "robot's calibration file. Zero is the middle of that range, not where a link hangs: set offset")


def _bam(facts: Mapping[str, str], duty: bool) -> list[str]:
    """Known values of BAM's pendulum, and what its servo's gain is by its authors."""
    out: list[str] = []
    try:
        mass, length, arm = (float(facts.get(f"bam.{key}", "0")) for key in ("mass", "length", "arm"))
        kp = float(facts.get("bam.kp", "nan"))
    except ValueError:
        return out
    if mass > 0.0 and length > 0.0:
        moment = mass * length + 0.5 * arm * length
        then = "over the fitted beta2 that is N m per volt" if duty else \
            f"legid fit --fix beta2={moment:.4g} gives the other parameters in N m, and the servo's gain"
        out.append(f"BAM's pendulum has m*lc = {moment:.4g} kg m by the file's mass and length: {then}")
    per = next((gain for motor, gain in BAM_DUTY.items() if motor in facts.get("bam.motor", "").lower()), None)
    if per is not None and np.isfinite(kp) and not duty:
        out.append(f"by BAM this servo's duty is {per * kp:.4g} (command - angle) at kp {kp:g}: with input = "
                   '"voltage" that is servo.gain')
    return out
