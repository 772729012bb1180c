"""Commands of joints whose drives follow an angle: which angle each belongs to, its unit and its sign.

A drive that follows a command turns the joint by gain * (command - angle), so that the command's error stands for a
torque of unknown scale. Unit and sign of a command follow from the angle that follows it. What the loop adds, such as a
delay or an integral, is not known here: where the equation of motion does not explain the error, the units of the
names stay, with a warning.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec import structs

from daq import Column, Dataset, FloatArray
from estimator.calibration import TRIED
from experiments.exchange.guess_names import NOT_AN_ANGLE, NOT_MEASURED, TIME_NAMES, changes, kind_of, says
from experiments.exchange.guess_physics import filled, smooth
from experiments.exchange.imported import ImportedFile

A_COMMAND = r"goal|target|cmd|command|set_?point|desired|(?<![a-z])action|joint_trajectory"
"""Names of commands that need no word of an angle."""
A_RATE = r"vel|speed|rate|dot|(?<![a-z])qd"
A_FEEDFORWARD = r"feed_?forward|(?<![a-z])ff(?![a-z])"
SURE_RATE = 0.9
"""Correlation with the derivative of the command beyond which a column is its rate."""
FOLLOWS = 0.5
"""Correlation of an angle with its command, the best of all delays, below which it does not follow it."""
LATEST_S = 0.5
"""Delays that are tried."""
ALIKE = 2.0
"""A slope of the angle over the command within this factor of a unit's is that unit's."""


class Command(NamedTuple):
    """A command, and how the angle follows it."""

    angle: Column
    command: Column
    follows: float
    """Correlation at the best delay, of either sign."""
    late_s: float
    """That delay [s]."""


def commands_of(imported: ImportedFile) -> list[str]:
    """Columns that are commanded angles by their names, in the file's order."""
    return [name for name in imported.names if says(name, NOT_MEASURED) and not says(name, TIME_NAMES)
            and not says(re.sub(r"set_?point", "", name, flags=re.IGNORECASE), NOT_AN_ANGLE)
            and (kind_of(name) in ("q1", "q2") or (not kind_of(name) and says(name, A_COMMAND)))
            and changes(imported.values(name))]


def read_command(run: Dataset, names: tuple[str, str], angle: Column, command: Column) -> Command:
    """Units and sign of a command by the angle that follows it.

    `names` are the columns of angle and command in `run`, read by the units that `angle` and `command` state.
    """
    if any(name not in run or not np.isfinite(run[name]).any() for name in names):  # larger than any reading
        return Command(angle, command, 0.0, 0.0)
    q, c = (filled(run[name]) for name in names)
    follows, late = _following(q, c, run.rate_hz)
    lead = c[: c.size - late] if late else c
    slope = max(abs(follows) * float(q[late:].std()) / max(float(lead.std()), 1e-30), 1e-9)
    angle, command = _in_units(angle, command, slope)
    return Command(angle, structs.replace(command, sign=1 if follows > 0 else -1), follows, late / run.rate_hz)


def _in_units(angle: Column, command: Column, slope: float) -> tuple[Column, Column]:
    """Both with the units by which the angle moves as far as its command, where names state one or none of them."""
    one, other, near, inverse = angle.unit, command.unit, _unit_near(slope), _unit_near(1.0 / slope)
    if one and not other:
        other = near or one
    elif other and not one:
        one = inverse or other
    elif not one and not 1.0 / ALIKE < slope < ALIKE:
        one, other = ("rad", near) if near else (inverse, "rad" if inverse else "")
    return structs.replace(angle, unit=one), structs.replace(command, unit=other)


def _unit_near(factor_rad: float) -> str:
    """The unit of an angle that is about so many rad; empty for none."""
    near = [unit or "rad" for unit, scale in TRIED["rad"].items() if 1.0 / ALIKE < factor_rad / scale < ALIKE]
    return near[0] if near else ""


def _following(q: FloatArray, c: FloatArray, rate_hz: float) -> tuple[float, int]:
    """Correlation of largest size of q (n,) with c (n,) before it, and by how many samples."""
    most = min(int(LATEST_S * rate_hz), q.size // 4)
    found = [_correlation(q[k:], c[: c.size - k]) for k in range(most + 1)]
    best = int(np.argmax(np.abs(found)))
    return found[best], best


def _correlation(q: FloatArray, c: FloatArray) -> float:
    q, c = q - q.mean(), c - c.mean()
    return float(q @ c / max(float(np.sqrt((q @ q) * (c @ c))), 1e-30))


def not_following(one: Command) -> str:
    """Why a command cannot be used, in a sentence; empty for one that can."""
    if abs(one.follows) >= FOLLOWS:
        return ""
    return (f"{one.angle.name!r} does not follow {one.command.name!r} (correlation {one.follows:.2f} at best): the "
            "command of another joint, or a drive that was off")


def followed(one: Command) -> str:
    """Words for how the angle follows: delay, correlation and sign."""
    return (f"{one.angle.name!r} follows it {1e3 * one.late_s:.0f} ms later (correlation {abs(one.follows):.3f}), sign "
            f"{one.command.sign:+d}")


def servo_hint(joints: Sequence[int]) -> str:
    """Advice for the rig file of joints that follow commands and log no torque."""
    named = ", ".join(f"q{j}_cmd_rad" for j in joints)
    return (f"no torque: the drive follows {named}. The rig file needs [servo], which legid init --from RUN.csv "
            "writes. Give its gain in N m/rad there, or one known parameter to legid fit with --fix")


def rates_of(imported: ImportedFile) -> list[str]:
    """Columns that are commanded rates by their names, in the file's order."""
    return [name for name in imported.names if says(name, NOT_MEASURED)
            and says(name, A_RATE) and kind_of(name) != "tau"
            and changes(imported.values(name))]


def feedforwards_of(imported: ImportedFile) -> list[str]:
    """Columns that are feedforward torques by their names, in the file's order."""
    return [name for name in imported.names if says(name, A_FEEDFORWARD)
            and not says(name, A_RATE) and changes(imported.values(name))]


def is_rate_of(rate: FloatArray, command: FloatArray, rate_hz: float) -> int:
    """1 or -1 where `rate` (n,) [rad/s] is the derivative of `command` (n,) [rad] or its negative, else 0."""
    slow, wanted = (smooth(x, rate_hz) for x in (rate, np.gradient(filled(command), 1.0 / rate_hz)))
    size = float(slow.std()) / max(float(wanted.std()), 1e-30)
    alike = _correlation(slow, wanted)
    return int(np.sign(alike)) if abs(alike) > SURE_RATE and 1.0 / ALIKE < size < ALIKE else 0
