"""Feetech's serial bus of STS and SMS servos: packets to bytes and back, the memory table, signs and units.

A packet is FF FF, identifier, length, instruction or error, parameters, checksum. The length counts instruction,
parameters and checksum; the checksum is the complement of the sum of all bytes behind the header. Words are little
endian; a signed one is a magnitude with a sign bit. Sources: Feetech's "STS Servo Memory Table" and its library
ftservo-python-sdk (github.com/ftservo/FTServo_Python, scservo_sdk/sms_sts.py).
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from drivers.packet_stream import THROWN, PacketStream, Thrown

HEADER = b"\xff\xff"
BROADCAST = 0xFE
LONGEST = 96
"""Bytes of instruction, parameters and checksum that are believed: more is a length that was damaged."""


class Instruction(IntEnum):
    """Fifth byte of a packet from the host."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class Packet(NamedTuple):
    """One packet. `code` is the instruction, or the error of a status packet: the bytes do not tell which."""

    ident: int
    code: int
    params: bytes


class Address(IntEnum):
    """Addresses of the memory table that are used here."""

    FIRMWARE = 0
    MODEL = 3
    IDENT = 5
    STATUS_LEVEL = 8
    MAX_TEMPERATURE = 13
    MAX_VOLTAGE = 14
    MIN_VOLTAGE = 15
    PHASE = 18
    MODE = 33
    TORQUE_ENABLE = 40
    GOAL_POSITION = 42
    GOAL_TIME = 44
    LOCK = 55
    PRESENT_POSITION = 56
    PRESENT_SPEED = 58
    PRESENT_LOAD = 60
    PRESENT_VOLTAGE = 62
    PRESENT_TEMPERATURE = 63
    STATUS = 65
    PRESENT_CURRENT = 69


class Status(IntEnum):
    """Bits of a status packet's error and of the register Status."""

    VOLTAGE = 1 << 0
    ENCODER = 1 << 1
    TEMPERATURE = 1 << 2
    CURRENT = 1 << 3
    LOAD = 1 << 5


TABLE = 87
COUNTS = 4096
"""Counts of the position, a turn of the output."""
CURRENT_A = 6.5e-3
"""A count of the current [A]."""
POSITION_MODE, PWM_MODE = 0, 2
PWM_FULL = 1000
"""Goal Time in PWM mode: a duty of 1, its sign in bit 10."""
MULTI_TURN, NO_CURRENT = 0x10, 0x20
"""Bits of Phase: the position counts turns; the bridge has no current feedback."""
MODELS = {777: "STS3215", 2825: "STS3250"}
"""Names by model number (huggingface/lerobot, motors/feetech/tables.py)."""


def checksum(data: bytes) -> int:
    """Checksum of the bytes behind a header."""
    return ~sum(data) & 0xFF


def packet(ident: int, code: int, params: bytes = b"") -> bytes:
    """The packet's bytes. Raises ValueError for an identifier that there is not."""
    if not 0 <= ident <= BROADCAST:
        raise ValueError(f"a Feetech servo has no identifier {ident}")
    body = bytes([ident, len(params) + 2, code]) + params
    return HEADER + body + bytes([checksum(body)])


def read(ident: int, address: int, size: int) -> bytes:
    """Instruction: so many bytes from an address on."""
    return packet(ident, Instruction.READ, bytes([address, size]))


def silent_write(ident: int, address: int, data: bytes) -> bytes:
    """Instruction: bytes from an address on, which nobody answers. A sync write to one, as half duplex needs it."""
    return packet(BROADCAST, Instruction.SYNC_WRITE, bytes([address, len(data), ident]) + data)


def to_signed(word: int, bit: int = 15) -> int:
    """The number of a magnitude with its sign in `bit`."""
    size = word & ~(1 << bit)
    return -size if word & (1 << bit) else size


def from_signed(number: int, bit: int = 15) -> int:
    """The inverse of `to_signed`; what is larger than the magnitude can be becomes its largest."""
    return min(abs(number), (1 << bit) - 1) | (1 << bit) * (number < 0)


def word(table: bytes, at: int) -> int:
    """An unsigned word of the memory table."""
    return int.from_bytes(table[at:at + 2], "little")


class Decoder(PacketStream[Packet]):
    """Bytes to packets."""

    def _next(self) -> Packet | Thrown | None:
        start = self._buffer.find(HEADER)
        if start < 0:
            self._buffer = self._buffer[-1:] if self._buffer.endswith(b"\xff") else b""
            return None
        self._buffer = self._buffer[start:]
        if len(self._buffer) < 4:
            return None
        if self._buffer[2] == 0xFF:  # no identifier: the header begins one byte later
            self._buffer = self._buffer[1:]
            return THROWN
        length = self._buffer[3]
        if not 2 <= length <= LONGEST:
            return self._broken()
        end = 4 + length
        if len(self._buffer) < end:
            return None
        whole = self._buffer[:end]
        if checksum(whole[2:-1]) != whole[-1]:
            return self._broken()
        self._buffer = self._buffer[end:]
        return Packet(whole[2], whole[4], whole[5:-1])
