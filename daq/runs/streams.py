"""The topics of a run file: one table of fields gives the ROS 2 schema, the CDR bytes and the numpy type.

CDR aligns every field to its size. Within a message fields therefore go from large to small, and no padding
is ever needed: the payload is the packed struct behind the four encapsulation bytes 00 01 00 00 (little endian).
"""

from __future__ import annotations

import struct
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

CDR_HEADER = b"\x00\x01\x00\x00"
_CODES = {"int64": "q", "uint64": "Q", "float64": "d", "uint32": "I", "uint16": "H", "int32": "i", "int16": "h",
          "uint8": "B"}


class Field(NamedTuple):
    name: str
    ros: str
    note: str
    """Unit and meaning; a comment in the schema, so that the file explains itself."""


class Stream(NamedTuple):
    """One topic whose messages all have the same size."""

    topic: str
    schema: str
    fields: tuple[Field, ...]

    @property
    def text(self) -> str:
        """The ros2msg definition."""
        return "".join(f"{f.ros} {f.name}  # {f.note}\n" for f in self.fields)

    @property
    def packer(self) -> struct.Struct:
        return struct.Struct("<4s" + "".join(_CODES[f.ros] for f in self.fields))

    @property
    def dtype(self) -> np.dtype[np.void]:
        """One message's payload, encapsulation bytes included."""
        return np.dtype([("cdr", "V4"), *((f.name, np.dtype(f.ros).newbyteorder("<")) for f in self.fields)])

    def unpack(self, payloads: list[bytes]) -> NDArray[np.void]:
        """(n,) structured array of the payloads; those of another size are not of this stream's version."""
        dtype = self.dtype
        return np.frombuffer(b"".join(p for p in payloads if len(p) == dtype.itemsize), dtype)


IMU_STREAM = Stream("/imu", "legid_msgs/msg/ImuSample", (
    Field("drain_before_ns", "int64", "host monotonic clock before the FIFO's fill level was read [ns]"),
    Field("drain_after_ns", "int64", "the same after it"),
    Field("index", "uint64", "running sample count; all samples of one drain share the two times"),
    *(Field(f"{kind}_{axis}", "int16", f"raw {kind} counts, chip frame; scale in /config imu")
      for kind in ("gyro", "accel") for axis in "xyz"),
    Field("gap_before", "uint8", "1: an unknown number of samples is lost before this one"),
))
SLOW = Stream("/imu/slow", "legid_msgs/msg/ImuSlow", (
    Field("host_ns", "int64", "host monotonic clock after the reading [ns]"),
    Field("temperature_degc", "float64", "chip temperature [degC]; only its changes mean anything"),
    *(Field(f"field_{axis}", "int16", "raw magnetometer counts, its own axes; scale in /config imu") for axis in "xyz"),
    Field("field_valid", "uint8", "1: the field was read"),
))
TELEMETRY = Stream("/leg/telemetry", "legid_msgs/msg/LegTelemetry", (
    Field("host_ns", "int64", "host monotonic clock when the read that brought the frame returned [ns]"),
    Field("knee_rad", "float64", "motor encoder over gear ratio [rad], zero not taken off; NaN: invalid"),
    Field("pivot_hall_rad", "float64", "[rad]"),
    Field("knee_hall_rad", "float64", "[rad]"),
    Field("current_a", "float64", "mean motor current since the previous tick [A]"),
    Field("bus_v", "float64", "[V]"),
    Field("motor_degc", "float64", "[degC]"),
    Field("torque_cmd_nm", "float64", "joint torque that the current loop is asked for [N m]"),
    Field("tick_us", "uint32", "controller's clock modulo 2^32 at encoder sampling [us]"),
    Field("boot_id", "uint32", "boot that the tick belongs to"),
    Field("seq", "uint16", "frame counter modulo 2^16"),
    Field("faults", "uint16", "latched faults, bits of firmware_protocol.md"),
    Field("state", "uint8", "0 disarmed, 1 armed, 2 fault"),
))
CLOCK = Stream("/leg/clock", "legid_msgs/msg/ClockProbe", (
    Field("host_tx_ns", "int64", "host monotonic clock before the ping was written [ns]"),
    Field("host_rx_ns", "int64", "host monotonic clock when its answer had been read [ns]"),
    Field("rx_tick_us", "uint32", "controller's clock when the ping came in [us]"),
    Field("tx_tick_us", "uint32", "controller's clock when the answer went out [us]"),
    Field("boot_id", "uint32", "boot that the ticks belong to"),
    Field("ping_id", "uint16", ""),
))
COMMAND = Stream("/leg/command", "legid_msgs/msg/TorqueCommand", (
    Field("host_ns", "int64", "host monotonic clock before the command was written [ns]"),
    Field("torque_nm", "float64", "joint torque asked for [N m]"),
    Field("seq", "uint16", "command counter modulo 2^16"),
))
DISTANCE = Stream("/distance", "legid_msgs/msg/Distance", (
    Field("host_ns", "int64", "host monotonic clock at the middle of the reading [ns]"),
    Field("distance_m", "float64", "from the meter along its beam to the ground [m]"),
    Field("valid", "uint8", "0: the beam missed, or the meter gave no reading"),
))
PIVOT = Stream("/pivot", "legid_msgs/msg/PivotAngle", (
    Field("host_before_ns", "int64", "host monotonic clock before the transfer that brought the angle [ns]"),
    Field("host_after_ns", "int64", "the same after it"),
    Field("raw", "uint16", "counts, 4096 a turn; zero not taken off"),
    Field("magnitude", "uint16", "size of the magnet's field, of the chip's own unit"),
    Field("status", "uint8", "bit 5: magnet there, 4: too weak, 3: too strong"),
    Field("agc", "uint8", "gain of the chip's amplifier"),
))
SHUNT = Stream("/shunt", "legid_msgs/msg/ShuntCurrent", (
    Field("host_before_ns", "int64", "host monotonic clock before the transfer that brought the voltage [ns]"),
    Field("host_after_ns", "int64", "the same after it"),
    Field("raw", "int32", "counts of the shunt voltage; scale and length of a conversion in /config shunt"),
    Field("flags", "uint8", "1: no new conversion, 2: at the end of the chip's range"),
))
STREAMS = {stream.topic: stream for stream in (IMU_STREAM, SLOW, TELEMETRY, CLOCK, COMMAND, DISTANCE, PIVOT, SHUNT)}


class Note(NamedTuple):
    """A message of text: an event, or a piece of configuration learned after the file was opened."""

    host_ns: int
    kind: str
    text: str


NOTE_SCHEMA = "legid_msgs/msg/Note"
NOTE_TEXT = "int64 host_ns  # host monotonic clock [ns]\nstring kind\nstring text\n"
NOTE_TOPICS = ("/events", "/config")


def pack_note(note: Note) -> bytes:
    """CDR: a string is its length with the closing NUL as uint32, aligned to 4, then its bytes."""
    out = CDR_HEADER + struct.pack("<q", note.host_ns)
    for text in (note.kind, note.text):
        out += b"\0" * (-len(out) % 4)
        data = text.encode() + b"\0"
        out += struct.pack("<I", len(data)) + data
    return out


def unpack_note(payload: bytes) -> Note:
    """Inverse of `pack_note`; raises `struct.error` or ValueError on a payload that is none."""
    (host_ns,) = struct.unpack_from("<q", payload, 4)
    texts, at = [], 12
    for _ in range(2):
        at += -at % 4
        (length,) = struct.unpack_from("<I", payload, at)
        texts.append(payload[at + 4: at + 3 + length].decode())
        at += 4 + length
    return Note(host_ns, texts[0], texts[1])


def read_notes(payloads: list[bytes]) -> list[Note]:
    """All of them that are notes."""
    notes = []
    for payload in payloads:
        with suppress(struct.error, ValueError):
            notes.append(unpack_note(payload))
    return notes
