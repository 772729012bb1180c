"""`PacketStream`: bytes of a servo's line to packets, whatever their form."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

P = TypeVar("P")


class PacketStream(ABC, Generic[P]):
    """Packets from anywhere in a stream; a subclass knows their form."""

    def __init__(self) -> None:
        self._buffer = b""
        self.bad = 0
        """Broken packets that were thrown away."""

    def feed(self, data: bytes) -> list[P]:
        """Packets completed by `data`, in order."""
        self._buffer += data
        found: list[P] = []
        while (one := self._next()) is not None:
            if not isinstance(one, Thrown):
                found.append(one)
        return found

    def clear(self) -> None:
        """Forget a packet that was begun."""
        self._buffer = b""

    def _broken(self) -> Thrown:
        """Count a broken packet, and go on one byte later."""
        self.bad += 1
        self._buffer = self._buffer[1:]
        return THROWN

    @abstractmethod
    def _next(self) -> P | Thrown | None:
        """The next packet, THROWN for one that was thrown away, None where more bytes are needed."""


class Thrown:
    """Stands for bytes that are no packet."""


THROWN = Thrown()
