"""The messages of firmware_protocol.md version 1, as values in SI units, and their bytes.

One table of fields a message drives both directions, so that encoder and decoder cannot disagree; the
document's hand-written examples test the table itself.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from cobs import cobs
from fastcrc import crc16

VERSION = 1
DELIMITER = b"\x00"
CRC_SIZE = 2
MAX_FRAME = 64
"""Longest frame between two delimiters [bytes]; anything longer is noise."""
WATCHDOG_MS_MIN, WATCHDOG_MS_MAX = 5, 1000


class State(IntEnum):
    """Drive state, `state` of a Telemetry frame."""

    DISARMED = 0
    ARMED = 1
    FAULT = 2


class Fault(IntFlag):
    """Latched faults, `faults` of a Telemetry frame."""

    WATCHDOG = 1 << 0
    OVERCURRENT = 1 << 1
    OVERTEMPERATURE = 1 << 2
    UNDERVOLTAGE = 1 << 3
    OVERVOLTAGE = 1 << 4
    KNEE_ENCODER = 1 << 5
    KNEE_HALL = 1 << 6
    COMMAND_LIMIT = 1 << 7
    OVERSPEED = 1 << 8
    GATE_DRIVER = 1 << 9
    INTERNAL = 1 << 10
    ESTOP = 1 << 11
    POSITION_LIMIT = 1 << 12


ESTOP_OPEN = 1 << 15
"""Bit in `faults` of a Telemetry frame, no fault itself: the E-stop input is open now."""


class Feature(IntFlag):
    """`features` of DriveLimits."""

    TIMED_COMMANDS = 1 << 0
    ESTOP_INPUT = 1 << 1


class Reaction(IntEnum):
    """Reaction of the drive to a fault of the host or of the motion: nothing, motor shorted, position held."""

    LIMP = 0
    BRAKE = 1
    HOLD = 2


def describe_faults(faults: int) -> str:
    """The faults' names for a person: `watchdog, overspeed`; bits of a newer firmware as `bit 14`."""
    names = [f.name.lower().replace("_", " ") for f in Fault if f.name and faults & f]
    names += ["emergency stop is pressed"] if faults & ESTOP_OPEN else []
    known = [ESTOP_OPEN, *Fault]
    names += [f"bit {bit}" for bit in range(16) if faults >> bit & 1 and 1 << bit not in known]
    return ", ".join(names) or "none"


@dataclass(frozen=True)
class Telemetry:
    """Up, every period. NaN where the firmware marks a reading invalid. Joint angles are not wrapped."""

    seq: int
    """Counts telemetry frames modulo 2^16, from 0 at boot."""
    tick_us: int
    """MCU clock modulo 2^32 [us], latched when the knee encoder is sampled."""
    state: int
    faults: int
    knee_rad: float
    """Knee encoder (on the motor), divided by the gear ratio [rad]."""
    pivot_hall_rad: float
    knee_hall_rad: float
    current_a: float
    """Mean motor current since the previous telemetry tick [A]: centred half a period before `tick_us`."""
    bus_v: float
    motor_degc: float
    torque_cmd_nm: float
    """Joint torque the current loop is asked for at the tick, after derating [N m]; zero unless ARMED or holding."""

    @property
    def estop_open(self) -> bool:
        """The drive's E-stop input is open: pressed, or its wire broken."""
        return bool(self.faults & ESTOP_OPEN)


@dataclass(frozen=True)
class Hello:
    """Up, at boot, on request and once a second: who is there. Its layout never changes between versions."""

    version: int
    boot_id: int
    """Drawn anew at every boot: a changed one means that ticks and sequence numbers restarted."""
    telemetry_hz: int
    gear_ratio: float
    torque_limit_nm: float
    watchdog_ms: int
    """Longest watchdog time that `Arm` may ask for [ms]."""


@dataclass(frozen=True)
class Pong:
    """Up, answer to a Ping: MCU clock when its last byte came in and when the answer went out [us]."""

    ping_id: int
    rx_tick_us: int
    tx_tick_us: int


@dataclass(frozen=True)
class FaultReport:
    """Up, once for every fault that latches, and for every Arm refused because of one."""

    tick_us: int
    fault: int
    """The one bit that this report is about."""
    latched: int
    """All faults latched now."""
    value: float
    """What was measured, in the fault's own unit (A, degC, V, N m, rad/s, ms); NaN when there is none."""


@dataclass(frozen=True)
class DriveLimits:
    """Up, answer to a LimitsRequest: what the drive itself checks, and what it can do."""

    features: int
    reaction: int
    speed_limit_radps: float
    position_min_rad: float
    """Limit of the knee encoder's angle, as `Telemetry.knee_rad` [rad]."""
    position_max_rad: float


@dataclass(frozen=True)
class Heartbeat:
    """Up, on CAN only, ten times a second: who is there and in which state."""

    boot_id: int
    state: int
    faults: int


@dataclass(frozen=True)
class TorqueCommand:
    """Down: joint torque, and the only message that feeds the watchdog."""

    seq: int
    torque_nm: float


@dataclass(frozen=True)
class TimedCommand:
    """Down: as TorqueCommand, and obeyed only while the telemetry that it answers is younger than the watchdog."""

    seq: int
    torque_nm: float
    seen_seq: int
    """`seq` of the newest Telemetry that the host knew."""


@dataclass(frozen=True)
class Arm:
    """Down: DISARMED to ARMED with this watchdog time."""

    watchdog_ms: int


@dataclass(frozen=True)
class Stop:
    """Down: torque zero, ARMED to DISARMED; acknowledges a fault."""


@dataclass(frozen=True)
class ClearFaults:
    """Down: FAULT to DISARMED, only after a Stop and when the cause has gone."""


@dataclass(frozen=True)
class HelloRequest:
    """Down: asks for a Hello."""


@dataclass(frozen=True)
class Ping:
    """Down: asks for a Pong."""

    ping_id: int


@dataclass(frozen=True)
class LimitsRequest:
    """Down: asks for DriveLimits; older firmware does not know it and does not answer."""


Up = Telemetry | Hello | Pong | FaultReport | DriveLimits | Heartbeat
Down = TorqueCommand | TimedCommand | Arm | Stop | ClearFaults | HelloRequest | Ping | LimitsRequest
Message = Up | Down

TYPES: dict[type, int] = {
    TorqueCommand: 0x01, Arm: 0x02, Stop: 0x03, ClearFaults: 0x04, HelloRequest: 0x05, Ping: 0x06,
    TimedCommand: 0x07, LimitsRequest: 0x08,
    Telemetry: 0x81, Hello: 0x82, Pong: 0x83, FaultReport: 0x84, DriveLimits: 0x85,
}
_MICRO, _MILLI = 1e-6, 1e-3
LAYOUT: dict[type, tuple[tuple[str, float | None], ...]] = {
    # struct character and value of one unit (None: a plain integer), in the order of the dataclass's fields
    Telemetry: (("H", None), ("I", None), ("B", None), ("H", None), ("i", _MICRO), ("i", _MICRO), ("i", _MICRO),
                ("i", _MICRO), ("H", _MILLI), ("h", 0.01), ("i", _MICRO)),
    Hello: (("H", None), ("I", None), ("H", None), ("I", _MILLI), ("I", _MICRO), ("H", None)),
    Pong: (("H", None), ("I", None), ("I", None)),
    FaultReport: (("I", None), ("H", None), ("H", None), ("i", _MICRO)),
    DriveLimits: (("H", None), ("B", None), ("I", _MICRO), ("i", _MICRO), ("i", _MICRO)),
    TorqueCommand: (("H", None), ("i", _MICRO)),
    TimedCommand: (("H", None), ("i", _MICRO), ("H", None)),
    Arm: (("H", None),),
    Stop: (), ClearFaults: (), HelloRequest: (), LimitsRequest: (),
    Ping: (("H", None),),
}
RANGE = {"B": (0, 255), "H": (0, 65535), "I": (0, 2**32 - 1), "h": (-(2**15), 2**15 - 1), "i": (-(2**31), 2**31 - 1)}
SENTINEL = {"h": -(2**15), "i": -(2**31), "H": 65535, "I": 2**32 - 1}
"""Raw value of a scaled field that says 'not valid': the most negative, or all ones when unsigned."""
NO_SENTINEL = {(TorqueCommand, 1), (TimedCommand, 1), (Telemetry, 10)}
"""Torque commands are always a number: NaN is refused, not sent."""
_STRUCT = {kind: struct.Struct("<B" + "".join(code for code, _ in layout)) for kind, layout in LAYOUT.items()}
_KIND = {number: kind for kind, number in TYPES.items()}
_UNITS_PER = {_MICRO: 1e6, _MILLI: 1e3, 0.01: 100.0}


def _to_raw(kind: type, position: int, value: float) -> int:
    code, scale = LAYOUT[kind][position]
    low, high = RANGE[code]
    where = f"{kind.__name__} field {position}"
    if scale is None:
        raw = int(value)
    elif math.isnan(value):
        if (kind, position) in NO_SENTINEL:
            raise ValueError(f"{where}: NaN cannot be sent")
        return SENTINEL[code]
    else:
        if math.isinf(value):
            raise ValueError(f"{where}: infinity cannot be sent")
        raw = round(value * _UNITS_PER[scale])
        if raw == SENTINEL[code]:
            raise ValueError(f"{where}: {value} is the value that means 'invalid'")
    if not low <= raw <= high:
        raise ValueError(f"{where}: {value} does not fit the field")
    return raw


def encode(message: Message) -> bytes:
    """The message as one frame: COBS of type, fields and CRC, then the delimiter.

    Raises ValueError when a value does not fit its field.
    """
    kind = type(message)
    raw = [_to_raw(kind, i, value) for i, value in enumerate(vars(message).values())]
    payload = _STRUCT[kind].pack(TYPES[kind], *raw)
    return bytes(cobs.encode(payload + crc16.ibm_3740(payload).to_bytes(CRC_SIZE, "little"))) + DELIMITER


def _from_payload(kind: type, payload: bytes) -> Message:
    raw = _STRUCT[kind].unpack(payload)[1:]
    values = []
    for i, ((code, scale), number) in enumerate(zip(LAYOUT[kind], raw)):
        if scale is None:
            values.append(number)
        elif number == SENTINEL[code] and (kind, i) not in NO_SENTINEL:
            values.append(math.nan)
        else:
            values.append(number / _UNITS_PER[scale])
    message: Message = kind(*values)
    return message


class SequenceCount:
    """Telemetry missing by its sequence numbers, over wraps and reboots."""

    def __init__(self) -> None:
        self.lost = 0
        self._seq: int | None = None
        self._boot_id: int | None = None

    def see(self, message: Message) -> None:
        """Count what is missing before this message."""
        if isinstance(message, Hello):
            if message.boot_id != self._boot_id:
                self._seq, self._boot_id = None, message.boot_id
        elif isinstance(message, Telemetry):
            missing = 0 if self._seq is None else (message.seq - self._seq - 1) % 65536
            if missing < 32768:  # more is a frame repeated or from before, not a loss
                self.lost += missing
            self._seq = message.seq


class Decoder:
    """Bytes in any pieces to messages; counts what it had to throw away. The serial `Codec`.

    The first frame after the start may be the tail of one already under way: it is not counted.
    """

    unit = "bytes"
    cut = DELIMITER
    beats = False

    def __init__(self) -> None:
        self.bad_crc = 0
        self.bad_length = 0
        self.unknown = 0
        self._sequence = SequenceCount()
        self._rest = b""
        self._started = False

    @property
    def lost(self) -> int:
        """Telemetry frames missing by their sequence numbers."""
        return self._sequence.lost

    def encode(self, message: Message) -> bytes:
        """`encode` of this module."""
        return encode(message)

    def feed(self, chunk: bytes) -> list[Message]:
        """Messages completed by `chunk`, in order."""
        *frames, rest = (self._rest + chunk).split(DELIMITER)
        self._rest = rest[: MAX_FRAME + 1]  # one byte too long stays too long: counted once, at its delimiter
        messages = []
        for frame in frames:
            fault, message = self._decode(frame) if frame else (None, None)
            if fault is not None and self._started:
                setattr(self, fault, getattr(self, fault) + 1)
            if message is not None:
                self._sequence.see(message)
                messages.append(message)
            self._started = True
        return messages

    def _decode(self, frame: bytes) -> tuple[str | None, Message | None]:
        """(name of the counter, None) or (None, message)."""
        if len(frame) > MAX_FRAME:
            return "bad_length", None
        try:
            data = bytes(cobs.decode(frame))
        except cobs.DecodeError:
            return "bad_crc", None
        if len(data) <= CRC_SIZE:
            return "bad_length", None
        payload, crc = data[:-CRC_SIZE], data[-CRC_SIZE:]
        if crc16.ibm_3740(payload) != int.from_bytes(crc, "little"):
            return "bad_crc", None
        kind = _KIND.get(payload[0])
        if kind is None:
            return "unknown", None
        if len(payload) != _STRUCT[kind].size:
            return "bad_length", None
        return None, _from_payload(kind, payload)
