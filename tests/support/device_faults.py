"""Faults put between a driver and an emulated device: on the wire, on the I2C bus, on the disk.

Nothing here is random by itself: whoever injects hands in a seeded generator, or says when.
"""

import errno
import os
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, BinaryIO

import numpy as np

from drivers import LinkLost
from drivers.can_frame import CanFrame
from drivers.link import Link
from drivers.mock import Clock


@dataclass(frozen=True)
class WireFaults:
    """Share of frames to which each of these happens; at most one to a frame."""

    flip: float = 0.0
    """One to three bits, delimiters included; on CAN, whose controllers drop such frames, the length is cut."""
    drop: float = 0.0
    duplicate: float = 0.0
    swap: float = 0.0
    """With the frame that follows."""
    garbage: float = 0.0
    """Up to 90 bytes of noise, or a frame of noise, in front of it."""
    cut: float = 0.0
    """Only its first bytes come, as when a cable or an MCU goes in mid frame; a whole frame follows at once."""


KINDS = tuple(f.name for f in fields(WireFaults))


class FaultyWire:
    """Mangles frames one by one: serial frames as bytes with their delimiter, CAN frames as `CanFrame`."""

    def __init__(self, faults: WireFaults, rng: np.random.Generator) -> None:
        self.injected: Counter[str] = Counter()
        self._faults, self._rng = faults, rng
        self._held: list[Any] = []

    @property
    def sound(self) -> bool:
        """Nothing is done to any frame."""
        return not any(getattr(self._faults, kind) for kind in KINDS)

    def pass_on(self, frame: Any) -> list[Any]:
        """What arrives instead of this frame: nothing, itself, or worse."""
        kind = self._dice()
        if kind == "swap" and not self._held:
            self.injected[kind] += 1
            self._held.append(frame)
            return []
        out = self._mangled(frame, kind)
        if kind and kind != "swap":
            self.injected[kind] += 1
        return [*out, *self.release()]

    def release(self) -> list[Any]:
        """A frame that waits to be swapped with one that never came."""
        held, self._held = self._held, []
        return held

    def _dice(self) -> str:
        throw = self._rng.random()
        for kind in KINDS:
            throw -= getattr(self._faults, kind)
            if throw < 0:
                return kind
        return ""

    def _mangled(self, frame: Any, kind: str) -> list[Any]:
        can = isinstance(frame, CanFrame)
        if kind == "drop":
            return []
        if kind == "duplicate":
            return [frame, frame]
        if can and kind in ("flip", "cut"):
            return [frame._replace(data=frame.data[:-1])] if frame.data else []
        if kind == "flip":
            out = bytearray(frame)
            for at in self._rng.choice(8 * len(out), int(self._rng.integers(1, 4)), replace=False):
                out[at // 8] ^= 1 << int(at) % 8
            return [bytes(out)]
        if kind == "cut":
            return [frame[: int(self._rng.integers(1, len(frame)))], b"\0"]
        if kind == "garbage" and can:
            return [CanFrame(int(self._rng.integers(2048)), self._rng.bytes(int(self._rng.integers(9)))), frame]
        if kind == "garbage":
            return [self._rng.bytes(int(self._rng.integers(1, 91))), frame]
        return [frame]


class FaultyLink:
    """A link whose upward frames go through a `FaultyWire`, and whose cable can stall and be pulled."""

    def __init__(self, inner: Link[Any], clock: Clock, wire: FaultyWire | None = None) -> None:
        self._inner, self._clock = inner, clock
        self.wire = wire or FaultyWire(WireFaults(), np.random.default_rng(0))
        self._quiet_until_ns = 0
        self._plugged = True
        self._kept: deque[Any] = deque()

    def stall(self, seconds: float) -> None:
        """The far end is silent for so long; what it has to say then comes at once."""
        self._quiet_until_ns = self._clock.now_ns() + round(seconds * 1e9)

    def unplug(self) -> None:
        """Both directions are gone until `replug`; what is under way is lost."""
        self._plugged = False

    def replug(self) -> None:
        """The cable is back. A driver that met the loss opens the port anew."""
        while self._inner.read():
            continue
        self._plugged = True

    def read(self) -> Any:
        """What arrived, mangled. Raises `LinkLost` while unplugged."""
        self._check()
        data = self._inner.read()
        if self._clock.now_ns() < self._quiet_until_ns:
            self._kept.append(data)
            return data[:0]
        while self._kept:
            data = self._kept.pop() + data
        if self.wire.sound:
            return data  # as it is: not every protocol on a serial line ends its frames with a NUL
        if isinstance(data, tuple):
            return tuple(frame for whole in data for frame in self.wire.pass_on(whole))
        return b"".join(part for whole in data.split(b"\0")[:-1] for part in self.wire.pass_on(whole + b"\0"))

    def write(self, data: Any) -> None:
        """Down the wire, untouched. Raises `LinkLost` while unplugged."""
        self._check()
        self._inner.write(data)

    def close(self) -> None:
        """Let go of the inner link."""
        self._inner.close()

    def _check(self) -> None:
        if not self._plugged:
            raise LinkLost("leg controller on the faulty link: the connection is gone; check cable and power")


class FaultyI2C:
    """A bus on which single transfers fail: `schedule[k]` is what happens to transfer number k from now on."""

    def __init__(self, chip: Any, schedule: dict[int, Callable[[], None]]) -> None:
        self._chip, self._schedule = chip, schedule
        self.transfers = 0
        self.reads: int | None = None
        """A byte that every read brings, whatever the chip says: lines that are held low (0) or not at all (255)."""

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """The chip's transfer, after what is scheduled for it."""
        happens = self._schedule.get(self.transfers)
        self.transfers += 1
        if happens is not None:
            happens()
        self._chip.i2c_rdwr(*i2c_msgs)
        for message in i2c_msgs if self.reads is not None else ():
            for k in range(message.len if message.flags & 1 else 0):
                message.buf[k] = bytes([self.reads or 0])

    def close(self) -> None:
        """Let go of the chip's bus."""
        self._chip.close()


class FaultyDisk:
    """A file on a disk that is slow, or that is full after so many bytes. Everything else is the real file's."""

    def __init__(self, file: BinaryIO, delay_s: float = 0.0, room: float = float("inf")) -> None:
        self._file, self._delay_s, self._room = file, delay_s, room

    def write(self, data: Any) -> int:
        """Waits, then writes. Raises OSError(ENOSPC) beyond the room there is."""
        time.sleep(self._delay_s)
        self._room -= len(data)
        if self._room < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._file.write(data)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)
