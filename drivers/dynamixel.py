"""Dynamixel protocol 2.0: packets to bytes and back, the X series' control table, models with their units.

A packet is FF FF FD 00, identifier, length, instruction, parameters, CRC-16. FF FF FD within it gets another FD. The
length counts instruction, parameters with what was stuffed, and CRC. Sources: ROBOTIS e-Manual, pages "DYNAMIXEL
Protocol 2.0" and the control tables of each model (emanual.robotis.com/docs/en/dxl/protocol2/, .../dxl/x/xl330-m288/).
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

from fastcrc import crc16

from drivers.packet_stream import THROWN, PacketStream, Thrown

HEADER = b"\xff\xff\xfd\x00"
TRIGGER, STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
BROADCAST = 0xFE
LONGEST = 512
"""Bytes of instruction, parameters and CRC that are believed: more is a length that was damaged."""
ALERT = 0x80
"""Bit of a status packet's error: Hardware Error Status is not zero."""


class Instruction(IntEnum):
    """Third field of a packet."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class Packet(NamedTuple):
    """One packet; of a status packet the error is apart from the parameters."""

    ident: int
    instruction: int
    error: int
    params: bytes


class Address(IntEnum):
    """Addresses of the control table that are used here."""

    MODEL_NUMBER = 0
    FIRMWARE_VERSION = 6
    RETURN_DELAY_TIME = 9
    DRIVE_MODE = 10
    OPERATING_MODE = 11
    TEMPERATURE_LIMIT = 31
    MAX_VOLTAGE_LIMIT = 32
    MIN_VOLTAGE_LIMIT = 34
    CURRENT_LIMIT = 38
    VELOCITY_LIMIT = 44
    SHUTDOWN = 63
    TORQUE_ENABLE = 64
    STATUS_RETURN_LEVEL = 68
    HARDWARE_ERROR_STATUS = 70
    BUS_WATCHDOG = 98
    GOAL_CURRENT = 102
    REALTIME_TICK = 120
    PRESENT_CURRENT = 126
    PRESENT_VELOCITY = 128
    PRESENT_POSITION = 132
    PRESENT_INPUT_VOLTAGE = 144
    PRESENT_TEMPERATURE = 146


CURRENT_MODE = 0
COUNTS = 4096
"""Counts of the position, a turn of the output."""
VELOCITY_RPM = 0.229
WATCHDOG_UNIT_MS = 20
WATCHDOG_ERROR = 0xFF
TICK_WRAP = 32768
"""Period of the realtime tick [ms]."""
OLDEST_WITH_WATCHDOG = 38
"""Firmware."""


class HardwareError(IntEnum):
    """Bits of Hardware Error Status."""

    INPUT_VOLTAGE = 1 << 0
    OVERHEATING = 1 << 2
    ENCODER = 1 << 3
    ELECTRICAL_SHOCK = 1 << 4
    OVERLOAD = 1 << 5


class Model(NamedTuple):
    """Properties in which models with a current mode differ."""

    name: str
    current_a: float
    """A count of goal, present and limit of the current [A]."""


MODELS = {1190: Model("XL330-M077", 1e-3), 1200: Model("XL330-M288", 1e-3), 1210: Model("XC330-T181", 1e-3),
          1220: Model("XC330-T288", 1e-3), 1230: Model("XC330-M181", 1e-3), 1240: Model("XC330-M288", 1e-3),
          1020: Model("XM430-W350", 2.69e-3), 1030: Model("XM430-W210", 2.69e-3), 1000: Model("XH430-W350", 2.69e-3),
          1010: Model("XH430-W210", 2.69e-3), 1040: Model("XH430-V350", 1.34e-3), 1050: Model("XH430-V210", 1.34e-3),
          1120: Model("XM540-W270", 2.69e-3), 1130: Model("XM540-W150", 2.69e-3)}
"""Models by model number."""


def crc(data: bytes) -> int:
    """CRC-16 with polynomial 0x8005 from 0, as the e-Manual's table has it."""
    found: int = crc16.umts(data)
    return found


def packet(ident: int, instruction: int, params: bytes = b"") -> bytes:
    """The packet's bytes. Raises ValueError for an identifier that there is not."""
    if not 0 <= ident <= BROADCAST:
        raise ValueError(f"a Dynamixel has no identifier {ident}")
    body = (bytes([instruction]) + params).replace(TRIGGER, STUFFED)
    whole = HEADER + struct.pack("<BH", ident, len(body) + 2) + body
    return whole + struct.pack("<H", crc(whole))


def status(ident: int, error: int, params: bytes = b"") -> bytes:
    """A status packet's bytes."""
    return packet(ident, Instruction.STATUS, bytes([error]) + params)


def read(ident: int, address: int, size: int) -> bytes:
    """Instruction: so many bytes from an address on."""
    return packet(ident, Instruction.READ, struct.pack("<HH", address, size))


def silent_write(ident: int, address: int, data: bytes) -> bytes:
    """Instruction: bytes from an address on, which nobody answers. A sync write to one: on a line of half duplex an
    answer would meet the next request."""
    return packet(BROADCAST, Instruction.SYNC_WRITE, struct.pack("<HHB", address, len(data), ident) + data)


class Decoder(PacketStream[Packet]):
    """Bytes to packets."""

    def _next(self) -> Packet | Thrown | None:
        start = self._buffer.find(HEADER)
        if start < 0:
            self._buffer = self._buffer[-len(HEADER) + 1:]
            return None
        self._buffer = self._buffer[start:]
        if len(self._buffer) < 7:
            return None
        ident, length = struct.unpack_from("<BH", self._buffer, 4)
        if not 3 <= length <= LONGEST:
            return self._broken()
        end = 7 + length
        if len(self._buffer) < end:
            if HEADER in self._buffer[4:]:  # stuffing lets no header into a packet: this one broke off
                return self._broken()
            return None
        whole = self._buffer[:end]
        if crc(whole[:-2]) != struct.unpack("<H", whole[-2:])[0]:
            return self._broken()
        self._buffer = self._buffer[end:]
        body = whole[7:-2].replace(STUFFED, TRIGGER)
        if body[0] != Instruction.STATUS:
            return Packet(ident, body[0], 0, body[1:])
        return Packet(ident, body[0], body[1], body[2:]) if len(body) > 1 else THROWN


def unsigned(table: bytes, at: int, size: int) -> int:
    """A number of the control table."""
    return int.from_bytes(table[at:at + size], "little")


def signed(table: bytes, at: int, size: int) -> int:
    """The signed number in the same bytes."""
    return int.from_bytes(table[at:at + size], "little", signed=True)
