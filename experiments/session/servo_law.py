"""A servo's position law in place of a torque channel: torque from the command and the encoder's reading.

The law uses the quantised reading, as the servo's controller does. The fit estimates the deviation of the real torque
as torque noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daq import Dataset, Rig, Servo
from estimator.signals import SUPPLY, command_columns, commands_of, input_by_law


def needs_law(data: Dataset, rig: Rig) -> bool:
    """Whether the rig declares a servo whose input the run does not have."""
    return rig.servo is not None and any(
        j in data.by_law or _input(rig, j) not in data for j in _joints(data, rig))


def with_law(data: Dataset, rig: Rig, servo: Servo) -> Dataset:
    """`data` with the position loop of every driven joint that has a command, and with the input that the loop gives
    where none was measured."""
    driven, joints = sorted(rig.mechanism.actuated), _joints(data, rig)
    loops = {j: servo.loop(driven.index(j), rig.mechanism.input == "voltage") for j in joints}
    found, columns = replace(data, loops=loops), dict(data.columns)
    made = tuple(j for j in joints if j in data.by_law or _input(rig, j) not in data)
    for j in made:
        angle, out = data[f"q{j}_rad"], np.full(len(data), np.nan)
        needed = [f"q{j}_rad", *(name for name in (*command_columns(j - 1), *SUPPLY[:1]) if name in data)]
        for where in data.segments(needed):
            commands = commands_of(found, j, where)
            if commands is not None:
                out[where] = input_by_law(commands, j - 1, angle[where], data.rate_hz, rig.filter.cutoff_hz,
                                          rig.filter.order)
        columns[_made(rig, j)] = out
    return replace(found, columns=columns, by_law=made)


def _joints(data: Dataset, rig: Rig) -> list[int]:
    return [j for j in rig.mechanism.actuated if f"q{j}_cmd_rad" in data and f"q{j}_rad" in data]


def _input(rig: Rig, joint: int) -> str:
    """Column that shows a joint's input, where one was measured."""
    return "duty" if rig.mechanism.input == "voltage" else f"tau{joint}_nm"


def _made(rig: Rig, joint: int) -> str:
    """Column of the input that a law makes."""
    return f"voltage{joint}_v" if rig.mechanism.input == "voltage" else f"tau{joint}_nm"
