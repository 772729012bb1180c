"""The guess for joints whose drives follow commands, without a torque in the file or with one."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from msgspec import structs

from daq import Column
from daq.runs import ENABLED
from experiments.exchange.column_map import apply_map, only_time
from experiments.exchange.guess_chain import find_chain
from experiments.exchange.guess_leg import guess_leg
from experiments.exchange.guess_names import clock_of, fitting, has, measured_columns, of_joints
from experiments.exchange.guess_physics import NOT_SURE
from experiments.exchange.guess_result import GuessedMap
from experiments.exchange.guess_servo import (
    Command,
    commands_of,
    feedforwards_of,
    followed,
    is_rate_of,
    not_following,
    rates_of,
    read_command,
    servo_hint,
)
from experiments.exchange.imported import ImportedFile
from experiments.exchange.joint_choice import too_many
from experiments.exchange.layouts import loads_of, motor_columns, stated, without_sign
from experiments.exchange.registers import angle_register
from experiments.exchange.units import unit_in_name

MOST_LINKS = 5
"""Of a chain whose columns are guessed."""
MOST_PRESENT = 0.9
"""Share of rows with a command below which it would cost the run too many of them."""
VOLTS = 'duty and volts: legid init --from RUN.csv writes input = "voltage"; parameters are then in volt units'


def guess_following(imported: ImportedFile, gravity_mps2: float) -> tuple[GuessedMap | None, list[str]]:
    """The guess for joints that follow commands and have no torque, or a current in counts alone; None for others.

    With it a sentence for each command that nothing follows.
    """
    angles, commands = measured_columns(imported, "q1", "q2"), commands_of(imported)
    counts = any(angle_register(imported, name) for name in angles)
    torques = [name for name in fitting(imported, "tau") if not without_sign(imported, name)]
    if not commands or not angles or (torques and not counts):
        return None, []
    imu = has(imported, "gyro", "accel")
    if len(angles) > MOST_LINKS and not imu:
        raise too_many(imported, angles)
    pairs = of_joints(angles, commands)
    clock, reasons = clock_of(imported)
    if imu or (len(angles) == 2 and len(pairs) == 1):
        knee = max(pairs, key=lambda j: angles[j] == (fitting(imported, "q2") or angles)[0])
        hips = [name for name in fitting(imported, "q1") if name != angles[knee]] or \
            [name for j, name in enumerate(angles) if j != knee][: 0 if imu else 1]
        order = {**({1: hips[0]} if hips else {}), 2: angles[knee]}
        joints = {2: pairs[knee]}
    else:
        order = dict(enumerate(angles, 1))
        joints = {j + 1: command for j, command in pairs.items()}
    read = _read_commands(imported, clock, order, joints)
    apart = [text for one in read.values() if (text := not_following(one))]
    if len(apart) == len(read):
        return None, apart
    if imu or (2 in order and len(order) == 2 and list(joints) == [2]):
        return _following_leg(imported, clock, reasons, order, read[2], gravity_mps2), []
    if len(order) == 1:
        return _following_joint(imported, clock, reasons, read[1], gravity_mps2), []
    return _following_chain(imported, clock, reasons, order, read), apart


def with_rates(guess: GuessedMap, imported: ImportedFile) -> GuessedMap:
    """`guess` with the commanded rates of its commands, where these are their derivatives, and with feedforwards."""
    commands = [(name, column) for name, column in guess.columns.items() if name.endswith("_cmd_rad")]
    named = [column.name for _, column in commands]
    columns, notes = {}, {}
    for k, rate in of_joints(named, rates_of(imported)).items():
        name, command = commands[k]
        unit = unit_in_name(rate, "gyro_radps") or (command.unit and f"{command.unit}/s")
        wanted, own = name.replace("q", "qd", 1).replace("rad", "radps"), Column(name=rate, unit=unit)
        run = apply_map(imported, only_time(guess.columns) | {name: command, wanted: own})
        sign = is_rate_of(run[wanted], run[name], run.rate_hz) if wanted in run and name in run else 0
        if sign:
            columns[wanted] = structs.replace(own, sign=1 if sign > 0 else -1)
            notes[wanted] = f"the derivative of {command.name!r}"
    for k, torque in of_joints(named, feedforwards_of(imported)).items():
        name, command = commands[k]
        wanted = name.replace("q", "tau", 1).replace("cmd_rad", "ff_nm")
        columns[wanted] = Column(name=torque, unit=unit_in_name(torque, wanted), sign=command.sign)
        notes[wanted] = "by its name, a feedforward"
    return _with(guess, columns, notes)


def with_loads(guess: GuessedMap, imported: ImportedFile) -> GuessedMap:
    """`guess` with the loads of its joints in a unit that the file does not state."""
    angles = {name: column for name, column in guess.columns.items() if re.fullmatch(r"q\d+_rad", name)}
    loads = loads_of(imported, angles)
    return _with(guess, loads, dict.fromkeys(loads, "by its name; its unit is not in the file"))


def _with(guess: GuessedMap, more: Mapping[str, Column], notes: Mapping[str, str]) -> GuessedMap:
    """`guess` with more columns."""
    return replace(guess, columns={**guess.columns, **more}, notes={**guess.notes, **notes})


def _read_commands(imported: ImportedFile, clock: dict[str, Column], order: Mapping[int, str],
                   joints: Mapping[int, str]) -> dict[int, Command]:
    """Joint from 1 -> its command, with the units and the sign that the angle shows."""
    theirs = {f"q{j}_rad": stated(imported, name, "q2_rad") for j, name in order.items()}
    theirs |= {f"q{j}_cmd_rad": stated(imported, name, "q2_rad") for j, name in joints.items()}
    run = apply_map(imported, clock | theirs)
    return {j: read_command(run, (f"q{j}_rad", f"q{j}_cmd_rad"), theirs[f"q{j}_rad"], theirs[f"q{j}_cmd_rad"])
            for j in joints}


def _following_joint(imported: ImportedFile, clock: dict[str, Column], reasons: dict[str, str], command: Command,
                     gravity_mps2: float) -> GuessedMap:
    """The guess for a single joint that follows a command; with its duty and volts where the file has both."""
    theirs = {"q1_rad": command.angle, "q1_cmd_rad": command.command}
    run = apply_map(imported, clock | theirs)
    error = {"tau1_nm": run["q1_cmd_rad"] - run["q1_rad"]}
    joint = find_chain(replace(run, columns={**run.columns, **error}), theirs, gravity_mps2)
    driven = motor_columns(imported)
    columns = joint.columns | driven | clock
    warnings = [*joint.warnings, VOLTS if "duty" in driven else servo_hint([1])]
    notes = reasons | joint.notes | {"q1_cmd_rad": followed(command)}
    notes |= dict.fromkeys(driven, "by its layout; the motor's voltage is duty times volts")
    if ENABLED in driven:
        notes[ENABLED] = "by its name; a motor that is off is open, and has no voltage"
    curves = {"q1_cmd_rad - q1_rad: measured, and computed from the motion [rad]": joint.check}
    return GuessedMap(columns, notes, warnings, [], curves)


def _following_chain(imported: ImportedFile, clock: dict[str, Column], reasons: dict[str, str],
                     order: Mapping[int, str], read: Mapping[int, Command]) -> GuessedMap:
    """The guess for several joints that follow commands: units by names, the rest as the file has it."""
    columns: dict[str, Column] = {}
    notes = dict(reasons)
    for j, name in order.items():
        columns[f"q{j}_rad"] = read[j].angle if j in read else stated(imported, name, "q2_rad")
        unit = columns[f"q{j}_rad"].unit
        notes[f"q{j}_rad"] = "by its name" if unit else f"{NOT_SURE}its unit does not show; rad is taken"
        if j in read and not not_following(read[j]):
            columns[f"q{j}_cmd_rad"] = read[j].command
            notes[f"q{j}_cmd_rad"] = followed(read[j])
    told = [f"joints {', '.join(map(repr, order.values()))} are taken for a chain in one plane: check that each angle "
            "counts against the link before, in one sense, and the first from hanging",
            servo_hint([j for j in order if f"q{j}_cmd_rad" in columns])]
    return GuessedMap(columns | clock, notes, told, [])


def _following_leg(imported: ImportedFile, clock: dict[str, Column], reasons: dict[str, str], order: Mapping[int, str],
                   command: Command, gravity_mps2: float) -> GuessedMap:
    """The guess for a leg whose knee follows a command: the command's error stands for the torque."""
    hip = {"q1_rad": stated(imported, order[1], "q1_rad")} if 1 in order else {}
    columns = hip | {"q2_rad": command.angle, "q2_cmd_rad": command.command} | clock
    found = guess_leg(imported, columns, dict(reasons), [], gravity_mps2)
    notes = found.notes | {"q2_cmd_rad": followed(command)}
    return replace(found, notes=notes, warnings=[*found.warnings, servo_hint([2])])


def with_commands(guess: GuessedMap, imported: ImportedFile) -> GuessedMap:
    """`guess` with the commands of its angles, where these follow them."""
    angles = [(name, column) for name, column in guess.columns.items() if re.fullmatch(r"q\d+_rad", name)
              and not column.minus]
    columns, notes = {}, {}
    for k, command in of_joints([column.name for _, column in angles], commands_of(imported)).items():
        name, angle = angles[k]
        wanted = name.replace("_", "_cmd_", 1)
        column = structs.replace(stated(imported, command, name), sign=angle.sign)
        if np.isfinite(imported.values(command)).mean() < MOST_PRESENT:
            continue
        run = apply_map(imported, only_time(guess.columns) | {name: angle, wanted: column})
        one = read_command(run, (name, wanted), angle, column)
        if not not_following(one) and one.angle == angle:
            columns[wanted] = structs.replace(one.command, sign=angle.sign * one.command.sign)
            notes[wanted] = followed(one)
    return _with(guess, columns, notes)
