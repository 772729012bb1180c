"""The messages of firmware_protocol.md on CAN, section 10: identifiers and fields by leg.dbc, through cantools.

A message of more than eight bytes goes as several frames. The first of them opens it, the others carry its tag; it is
delivered when all parts are there, and what does not belong together is counted, never joined.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import cantools.database

from drivers.can_frame import NODE_BITS, NODES, ONE_MESSAGE, CanFrame, Frames
from drivers.protocol import (
    ESTOP_OPEN,
    Arm,
    ClearFaults,
    DriveLimits,
    Fault,
    FaultReport,
    Heartbeat,
    Hello,
    HelloRequest,
    LimitsRequest,
    Message,
    Ping,
    Pong,
    SequenceCount,
    Stop,
    Telemetry,
    TimedCommand,
    TorqueCommand,
)

INVALID = "invalid"
LOW_FAULTS = 2**12 - 1
"""The faults that stand in the field of that name; the others have bits of their own."""
Values = dict[str, int]


PARTS: dict[type, tuple[str, ...]] = {
    Telemetry: ("Tick", "Knee", "Hall", "Drive"),
    Hello: ("Hello", "HelloRates", "HelloLimits"),
    FaultReport: ("FaultReport", "FaultValue"),
    DriveLimits: ("DriveLimits", "DriveRange"),
    Pong: ("Pong",), Heartbeat: ("Heartbeat",),
    **{kind: (kind.__name__,) for kind in (TorqueCommand, TimedCommand, Arm, Stop, ClearFaults, HelloRequest, Ping,
                                           LimitsRequest)},
}
"""The frames of each message, by their names in leg.dbc, in the order in which they are sent."""
_KIND = {part: kind for kind, parts in PARTS.items() for part in parts}
_TAG: dict[type, Callable[[Values], int]] = {
    Telemetry: lambda first: first["seq"],
    Hello: lambda first: first["boot_id"],
    FaultReport: lambda first: first["fault"] | first["tick_us"] << 4,
    DriveLimits: lambda first: first["features"],
}
"""From the values of a message's first frame to the tag of the others, of which as many low bits count as they hold."""


class Signal(NamedTuple):
    """One field of a frame."""

    name: str
    per_unit: float | None
    """Counts per unit; None: a plain integer."""
    invalid: int | None
    low: int
    high: int


class Layout(NamedTuple):
    """One frame of leg.dbc."""

    number: int
    name: str
    length: int
    signals: tuple[Signal, ...]
    message: Any
    """cantools' own object."""


@cache
def layouts() -> tuple[dict[int, Layout], dict[str, Layout]]:
    """leg.dbc by frame number and by name."""
    database: Any = cantools.database.load_string(files("drivers").joinpath("leg.dbc").read_text(), "dbc")
    found = [Layout(m.frame_id, m.name, m.length, tuple(_signal(s) for s in m.signals), m) for m in database.messages]
    return {frame.number: frame for frame in found}, {frame.name: frame for frame in found}


def _signal(s: Any) -> Signal:
    invalid = next((number for number, name in (s.choices or {}).items() if str(name) == INVALID), None)
    low, high = (-(2 ** (s.length - 1)), 2 ** (s.length - 1) - 1) if s.is_signed else (0, 2**s.length - 1)
    return Signal(s.name, None if s.scale == 1 else round(1 / s.scale), invalid, low, high)


class CanCodec:
    """Both directions for one node. Frames of other nodes are not its business and are passed over.

    The first parts after the start may belong to a message already under way: they are not counted.
    """

    unit = "frames"
    cut: Frames = ()
    beats = True

    def __init__(self, node: int = 0) -> None:
        if not 0 <= node < NODES:
            raise ValueError(f"node {node} is outside 0 to {NODES - 1}")
        self.node = node
        self.bad_crc = 0
        """Parts that belong to no message, and messages that lack a part. Bits are checked by CAN's own CRC."""
        self.bad_length = 0
        self.unknown = 0
        self._by_number, self._by_name = layouts()
        self._sequence = SequenceCount()
        self._open: dict[type, dict[str, Values]] = {}
        self._begun: set[type] = set()

    @property
    def lost(self) -> int:
        """Telemetry missing by its sequence numbers."""
        return self._sequence.lost

    def encode(self, message: Message) -> Frames:
        """The message's frames in their order. Raises ValueError when a value does not fit its field."""
        kind = type(message)
        values = _spread(message)
        frames: list[CanFrame] = []
        first: Values = {}
        for name in PARTS[kind]:
            layout = self._by_name[name]
            if first:
                tag = next(s for s in layout.signals if s.name == "tag")
                values["tag"] = _TAG[kind](first) & tag.high
            raw = {s.name: _to_raw(s, values[s.name], name) for s in layout.signals}
            first = first or raw
            data = bytes(layout.message.encode(raw, scaling=False, strict=False))
            frames.append(CanFrame(self.node << NODE_BITS | layout.number, data))
        return tuple(frames)

    def feed(self, chunk: Iterable[CanFrame]) -> list[Message]:
        """Messages completed by these frames, in order."""
        messages = []
        for frame in chunk:
            if frame.can_id >> NODE_BITS != self.node or frame.extended or frame.remote:
                continue
            message = self._take(frame)
            if message is not None:
                self._sequence.see(message)
                messages.append(message)
        return messages

    def _take(self, frame: CanFrame) -> Message | None:
        layout = self._by_number.get(frame.can_id & ONE_MESSAGE)
        if layout is None:
            self.unknown += 1
            return None
        if len(frame.data) != layout.length:
            self.bad_length += 1
            return None
        values: Values = layout.message.decode(frame.data, decode_choices=False, scaling=False) if layout.length else {}
        kind = _KIND[layout.name]
        names = PARTS[kind]
        if layout.name == names[0]:
            self.bad_crc += self._open.pop(kind, None) is not None  # the one before was never finished
            self._open[kind] = {layout.name: values}
            self._begun.add(kind)
        elif not self._belongs(kind, layout, values):
            self.bad_crc += kind in self._begun
            return None
        parts = self._open[kind]
        parts[layout.name] = values
        if len(parts) < len(names):
            return None
        del self._open[kind]
        return self._join(kind, parts)

    def _belongs(self, kind: type, layout: Layout, values: Values) -> bool:
        parts = self._open.get(kind)
        if parts is None or layout.name in parts:
            return False
        tag = next(s for s in layout.signals if s.name == "tag")
        return values["tag"] == _TAG[kind](parts[PARTS[kind][0]]) & tag.high

    def _join(self, kind: type, parts: dict[str, Values]) -> Message:
        values: dict[str, Any] = {}
        for name, raw in parts.items():
            for s in self._by_name[name].signals:
                values[s.name] = _from_raw(s, raw[s.name])
        return _gather(kind, values)


def _spread(message: Message) -> dict[str, Any]:
    """Values of all signals of a message's frames, tags aside."""
    values = dict(vars(message))
    if isinstance(message, Pong):
        values["turnaround_us"] = (values.pop("tx_tick_us") - message.rx_tick_us) % 2**32
    elif isinstance(message, FaultReport):
        values["fault"] = message.fault.bit_length() - 1
        values["latched"] &= LOW_FAULTS
    elif isinstance(message, Telemetry | Heartbeat):
        values["position_limit"] = bool(message.faults & Fault.POSITION_LIMIT)
        values["estop_open"] = bool(message.faults & ESTOP_OPEN)
        values["faults"] &= LOW_FAULTS
    return values


def _gather(kind: type, values: dict[str, Any]) -> Message:
    """The message from the values of all its signals."""
    values.pop("tag", None)
    if kind is Pong:
        values["tx_tick_us"] = (values["rx_tick_us"] + values.pop("turnaround_us")) % 2**32
    elif kind is FaultReport:
        values["fault"] = 1 << values["fault"]
        values["latched"] |= values["fault"] & ~LOW_FAULTS
    elif kind in (Telemetry, Heartbeat):
        values["faults"] |= Fault.POSITION_LIMIT * values.pop("position_limit")
        values["faults"] |= ESTOP_OPEN * values.pop("estop_open")
    message: Message = kind(**values)
    return message


def _to_raw(s: Signal, value: float, frame: str) -> int:
    where = f"{frame}.{s.name}"
    if s.per_unit is None:
        raw = int(value)
    elif math.isnan(value):
        if s.invalid is None:
            raise ValueError(f"{where}: NaN cannot be sent")
        return s.invalid
    elif math.isinf(value):
        raise ValueError(f"{where}: infinity cannot be sent")
    else:
        raw = round(value * s.per_unit)
        if raw == s.invalid:
            raise ValueError(f"{where}: {value} is the value that means 'invalid'")
    if not s.low <= raw <= s.high:
        if s.invalid is not None:
            return s.invalid  # as section 10 says of readings
        raise ValueError(f"{where}: {value} does not fit the field")
    return raw


def _from_raw(s: Signal, raw: int) -> float:
    if s.per_unit is None:
        return raw
    return math.nan if raw == s.invalid else raw / s.per_unit
