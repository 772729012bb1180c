"""Parts below the leg controller: a transport that moves chunks, and a codec between chunks and messages.

A chunk is `bytes` on a serial line and a tuple of frames on CAN; both can be joined with `+` and counted with `len`.
"""

from __future__ import annotations

from typing import Protocol, TypeVar

from drivers.protocol import Message

Chunk = TypeVar("Chunk")


class Link(Protocol[Chunk]):
    """A transport."""

    def read(self) -> Chunk:
        """Whatever arrived; blocks up to the link's timeout and returns an empty chunk then. Raises `LinkLost`."""

    def write(self, data: Chunk) -> None:
        """Hand over all of `data`. Raises `LinkLost`."""

    def close(self) -> None:
        """Let go of the transport; may be called twice."""


class Codec(Protocol[Chunk]):
    """Both directions of one framing. Holds the receiver's state and counts what it had to throw away."""

    bad_crc: int
    """Frames whose check sum, or whose parts, do not belong together."""
    bad_length: int
    unknown: int

    @property
    def lost(self) -> int:
        """Telemetry missing by its sequence numbers."""

    @property
    def unit(self) -> str:
        """Unit of `len` of a chunk."""

    @property
    def cut(self) -> Chunk:
        """Sent before a Stop: ends what may have been cut short on the wire."""

    @property
    def beats(self) -> bool:
        """It has a Heartbeat."""

    def feed(self, chunk: Chunk) -> list[Message]:
        """Messages completed by `chunk`, in order."""

    def encode(self, message: Message) -> Chunk:
        """The message as it goes over the wire. Raises ValueError when a value does not fit its field."""
