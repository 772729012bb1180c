"""Registers of servos on a serial bus, logged as the numbers that they hold: which column they are, unit, sign.

| register | Dynamixel X, protocol 2.0 | Feetech STS and SMS |
| --- | --- | --- |
| position | 4096 a turn, int32 | 4096 a turn, bit 15 the sign of a magnitude |
| load or PWM, as duty | PWM: 885 is full, int16 | load: 1000 is full, bit 10 the sign of a magnitude |
| voltage | 0.1 V | 0.1 V |

An MX of protocol 1.0 has a load of 1023 with its sign in bit 10, too. Sources: ROBOTIS' e-manual, "XL330-M288", control
table; Feetech's "STS Servo Memory Table"; `huggingface/lerobot`, motors/feetech/tables.py and encoding_utils.py.
"""

from __future__ import annotations

import math
import re

import numpy as np
from msgspec import structs

from daq import Column, FloatArray
from daq.runs import ENABLED
from experiments.exchange.imported import ImportedFile

TURN = 4096
PWM_FULL, LOAD_FULL = 885, 1000
COUNTS = 400
"""Whole numbers beyond it are counts, not degrees of one turn."""
MOST_VOLTS = 30.0
"""Of such a servo's supply; larger numbers are of 0.1 V."""
DYNAMIXEL, FEETECH = "Dynamixel", "Feetech"


def signed(read: FloatArray, column: Column) -> FloatArray:
    """(n,) numbers that the registers `read` (n,) stand for, by `bits` or `sign_bit` of the map."""
    if column.bits:
        half = 2.0 ** (column.bits - 1)
        return np.asarray(np.mod(read + half, 2.0 * half) - half)
    if column.sign_bit >= 0:
        sign = 2.0**column.sign_bit
        negative = np.mod(np.floor(read / sign), 2.0) == 1.0
        return np.asarray(np.where(read < 0.0, read, np.where(negative, -1.0, 1.0) * np.mod(read, sign)))
    return read


def maker(imported: ImportedFile) -> str:
    """Maker of the servos whose registers have these names, `DYNAMIXEL` or `FEETECH`; empty where they do not tell."""
    plain = " ".join(map(_plain, imported.names))
    if re.search(r"present_pwm|input_voltage|goal_pwm|goal_current", plain):
        return DYNAMIXEL
    return FEETECH if re.search(r"present_load", plain) and "moving_speed" not in plain else ""


def angle_register(imported: ImportedFile, name: str) -> Column | None:
    """The column of a position in counts, zero at half a turn; None where `name` is no such register."""
    if not re.search(r"(present|goal|target)_position|position_(present|goal|target)|pos(ition)?_(counts|raw|ticks)",
                     _plain(name)):
        return None
    counts = known(imported, name)
    if np.abs(counts).max() < COUNTS or (counts != np.round(counts)).any():
        return None
    most = counts.max()
    how = Column(name=name, unit="turn", scale=1.0 / TURN, offset=-math.pi)
    if most >= 2**31:
        return structs.replace(how, bits=32)
    return structs.replace(how, sign_bit=15) if most >= 2**15 and maker(imported) != DYNAMIXEL else how


def motor_registers(imported: ImportedFile) -> dict[str, Column]:
    """Columns `duty` and `volts` of one servo's registers, where both are there, and `torque_enable`, where it changes.
    """
    found = {_plain(name): name for name in imported.names}
    volts, pwm, load, on = (next((name for plain, name in found.items() if re.fullmatch(rf"(.*_)?{what}", plain)), "")
                            for what in (r"(input_)?voltage", "present_pwm", "present_load", ENABLED))
    enabled = {ENABLED: Column(name=on)} if on and np.ptp(known(imported, on)) > 0.0 else {}
    if not volts or not (pwm or load):
        return enabled
    counts = known(imported, pwm or load)
    if counts.max() <= 2.0 or not np.ptp(counts):
        return enabled
    supply = Column(name=volts, scale=0.1 if np.median(known(imported, volts)) > MOST_VOLTS else 1.0)
    duty = Column(name=pwm, scale=1.0 / PWM_FULL, bits=16) if pwm else \
        Column(name=load, scale=1.0 / LOAD_FULL, sign_bit=10)
    return {"duty": duty, "volts": supply, **enabled}


def known(imported: ImportedFile, name: str) -> FloatArray:
    """Its numbers that were read; one zero where none was."""
    values = imported.values(name)
    return values[np.isfinite(values)] if np.isfinite(values).any() else np.zeros(1)


def _plain(name: str) -> str:
    """In small letters, words joined by `_`: `Present Position` and `PresentPosition` alike."""
    return re.sub(r"[^a-z0-9]+", "_", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()).strip("_")
