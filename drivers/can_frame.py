"""`CanFrame`: one frame on a CAN bus, classic or CAN FD, and how many bytes of data it can have."""

from __future__ import annotations

from typing import NamedTuple

NODE_BITS = 5
"""An identifier of firmware_protocol.md, as one of ODrive's, is node << 5 | message."""
NODES = 2 ** (11 - NODE_BITS)
ONE_MESSAGE = 2**NODE_BITS - 1
FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""The lengths of data that CAN FD has (ISO 11898-1)."""


class CanFrame(NamedTuple):
    """A data frame; a classic one with an 11-bit identifier unless it says otherwise."""

    can_id: int
    data: bytes
    extended: bool = False
    """29-bit identifier."""
    fd: bool = False
    """CAN FD."""
    remote: bool = False
    """Asks for the data of this identifier."""


Frames = tuple[CanFrame, ...]


def padded(data: bytes, filler: int) -> bytes:
    """`data`, filled up to the next length that CAN FD has. Raises ValueError beyond 64 bytes."""
    length = next((n for n in FD_LENGTHS if n >= len(data)), None)
    if length is None:
        raise ValueError(f"{len(data)} bytes do not fit a CAN FD frame")
    return data + bytes([filler]) * (length - len(data))
