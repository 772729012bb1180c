"""Registers of moteus as the subframes of a CAN FD frame: mjlib's multiplex protocol.

Source: docs/protocol/can.md and docs/protocol/registers.md of github.com/mjbots/moteus. A frame holds subframes one
behind the other: which registers are written or read, from which on, in which type; a reply has the same form.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple

WRITE, READ, REPLY = 0x00, 0x10, 0x20
WRITE_ERROR, READ_ERROR = 0x30, 0x31
STREAM_TO_SERVER, STREAM_TO_CLIENT, STREAM_POLL = 0x40, 0x41, 0x42
NOP = 0x50
CONSOLE = 1
"""Channel of the text protocol (docs/protocol/diagnostic.md)."""


class Kind(IntEnum):
    """Type of a register's value on the wire."""

    INT8 = 0
    INT16 = 1
    INT32 = 2
    F32 = 3


_FORMAT = {Kind.INT8: "b", Kind.INT16: "h", Kind.INT32: "i", Kind.F32: "f"}
_SIZE = {Kind.INT8: 1, Kind.INT16: 2, Kind.INT32: 4, Kind.F32: 4}
_LOWEST = {Kind.INT8: -(2**7), Kind.INT16: -(2**15), Kind.INT32: -(2**31)}
"""What stands for NaN."""


class Register(IntEnum):
    """The registers that legid uses (docs/protocol/registers.md)."""

    MODE = 0x000
    POSITION = 0x001
    VELOCITY = 0x002
    TORQUE = 0x003
    Q_CURRENT = 0x004
    MOTOR_TEMPERATURE = 0x00A
    VOLTAGE = 0x00D
    TEMPERATURE = 0x00E
    FAULT = 0x00F
    COMMAND_POSITION = 0x020
    COMMAND_VELOCITY = 0x021
    COMMAND_TORQUE = 0x022
    KP_SCALE = 0x023
    KD_SCALE = 0x024
    MAXIMUM_TORQUE = 0x025
    STOP_POSITION = 0x026
    WATCHDOG_TIMEOUT = 0x027
    ILIMIT_SCALE = 0x02B
    CONTROL_TORQUE = 0x03A
    MILLISECONDS = 0x070
    MODEL = 0x100
    FIRMWARE_VERSION = 0x101
    REGISTER_MAP_VERSION = 0x102


class Subframe(NamedTuple):
    """One part of a frame."""

    op: int
    """WRITE, READ, REPLY, an error, or a stream's."""
    kind: Kind
    start: int
    """First register; of a stream its channel."""
    values: tuple[float, ...] = ()
    """Values of the registers from `start` on, as they stand on the wire; of a READ as many NaN as are asked for."""
    data: bytes = b""
    """Bytes of a stream."""


def write(kind: Kind, start: int, values: Sequence[float]) -> bytes:
    """Registers from `start` on get these values, as they stand on the wire."""
    return _head(WRITE, kind, len(values), start) + struct.pack(f"<{len(values)}{_FORMAT[kind]}", *values)


def read(kind: Kind, start: int, count: int = 1) -> bytes:
    """Asks for `count` registers from `start` on."""
    return _head(READ, kind, count, start)


def reply(kind: Kind, start: int, values: Sequence[float]) -> bytes:
    """Values that a READ returns."""
    return _head(REPLY, kind, len(values), start) + struct.pack(f"<{len(values)}{_FORMAT[kind]}", *values)


def read_error(register: int, number: int) -> bytes:
    """The reply for a register that there is not."""
    return bytes([READ_ERROR]) + varuint(register) + varuint(number)


def stream(op: int, data: bytes) -> bytes:
    """Bytes of the console, up or down."""
    return bytes([op]) + varuint(CONSOLE) + varuint(len(data)) + data


def poll_stream(most: int) -> bytes:
    """Asks for at most so many bytes of the console."""
    return bytes([STREAM_POLL]) + varuint(CONSOLE) + varuint(most)


def varuint(value: int) -> bytes:
    """Seven bits a byte, the low ones first."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def parse(data: bytes) -> Iterator[Subframe]:
    """The subframes of a frame, in order. Raises ValueError at the first that is none."""
    at = 0
    while at < len(data):
        op = data[at]
        at += 1
        if op == NOP:
            continue
        if op < 0x30:
            kind, count = Kind(op >> 2 & 3), op & 3
            if count == 0:
                count, at = _number(data, at)
            start, at = _number(data, at)
            if op & 0x30 == READ:
                if count > 64:
                    raise ValueError(f"asks for {count} registers at once")
                yield Subframe(READ, kind, start, (math.nan,) * count)
                continue
            end = at + count * _SIZE[kind]
            if end > len(data):
                raise ValueError("ends inside a value")
            yield Subframe(op & 0x30, kind, start, struct.unpack(f"<{count}{_FORMAT[kind]}", data[at:end]))
            at = end
        elif op in (WRITE_ERROR, READ_ERROR):
            register, at = _number(data, at)
            number, at = _number(data, at)
            yield Subframe(op, Kind.INT32, register, (number,))
        elif op in (STREAM_TO_SERVER, STREAM_TO_CLIENT, STREAM_POLL):
            channel, at = _number(data, at)
            count, at = _number(data, at)
            if op == STREAM_POLL:
                yield Subframe(op, Kind.INT8, channel, (count,))
                continue
            if at + count > len(data):
                raise ValueError("ends inside the console's text")
            yield Subframe(op, Kind.INT8, channel, (), data[at:at + count])
            at += count
        else:
            raise ValueError(f"there is no subframe 0x{op:02x}")


def scaled(value: float, kind: Kind, lsb: dict[Kind, float]) -> float:
    """A register's value from the wire: integers by their unit, the lowest one NaN."""
    if kind == Kind.F32:
        return value
    return math.nan if value == _LOWEST[kind] else value * lsb[kind]


def counted(value: float, kind: Kind, lsb: dict[Kind, float]) -> float:
    """The inverse of `scaled`, at the ends of the type's range where it does not fit."""
    if kind == Kind.F32:
        return value
    if math.isnan(value):
        return _LOWEST[kind]
    highest = -_LOWEST[kind] - 1
    return max(-highest, min(highest, round(value / lsb[kind])))


def _head(op: int, kind: Kind, count: int, start: int) -> bytes:
    if 1 <= count <= 3:
        return bytes([op | kind << 2 | count]) + varuint(start)
    return bytes([op | kind << 2]) + varuint(count) + varuint(start)


def _number(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 35, 7):
        if at >= len(data):
            break
        byte, at = data[at], at + 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("ends inside a number")
