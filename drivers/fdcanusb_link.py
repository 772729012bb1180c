"""mjbots' fdcanusb: CAN FD frames as lines of text on a USB serial port.

Down `can send ID HEX FLAGS`, answered `OK` or `ERR ...`; up `rcv ID HEX FLAGS`. Source: github.com/mjbots/fdcanusb.
"""

from __future__ import annotations

from drivers.can_frame import CanFrame, Frames
from drivers.link import Link

LONGEST = 512
"""A line that is longer is noise [bytes]."""


def line_of(frame: CanFrame) -> bytes:
    """The line that sends a frame."""
    flags = "BF" if frame.fd else "bf"
    return f"can send {frame.can_id:04x} {frame.data.hex()} {flags}\n".encode()


def checksum(text: bytes) -> int:
    """CRC-8 of polynomial 0x97 over `text`, which a line of `*XX` at its end has (docs/integration/uart.md)."""
    crc = 0
    for byte in text:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x97 if crc & 0x80 else crc << 1) & 0xFF
    return crc


def checked(line: bytes) -> bytes:
    """The line without its checksum, where it has one. Raises ValueError where that is wrong."""
    text, star, digits = line.rpartition(b"*")
    if not star or len(digits) != 2:
        return line
    if int(digits, 16) != checksum(text):
        raise ValueError("wrong checksum")
    return text


class FdcanusbCodec:
    """Lines up to frames; counts what is no line of an adapter."""

    def __init__(self) -> None:
        self.bad = 0
        self.refused = 0
        """Frames that the adapter did not send: `ERR`."""
        self._rest = b""

    def feed(self, data: bytes) -> Frames:
        """Frames completed by `data`, in order."""
        *lines, self._rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        if len(self._rest) > LONGEST:
            self.bad += 1
            self._rest = b""
        frames = []
        for line in lines:
            try:
                words = checked(line).split()
                if not words or words[0] == b"OK":
                    continue
                if words[0] == b"ERR":
                    self.refused += 1
                    continue
                if words[0] != b"rcv":
                    raise ValueError
                frames.append(CanFrame(int(words[1], 16), bytes.fromhex(words[2].decode("ascii")), b"E" in words[3:],
                                       True))
            except (ValueError, IndexError):  # also a byte that is no ASCII
                self.bad += 1
        return tuple(frames)


class FdcanusbLink:
    """A `Link` of frames over one of bytes: the adapter's serial port."""

    def __init__(self, inner: Link[bytes]) -> None:
        self._inner = inner
        self.codec = FdcanusbCodec()
        self.facts = {**getattr(inner, "facts", {}), "kind": "fdcanusb"}
        inner.write(b"\n")  # ends a line that somebody left unfinished

    def read(self) -> Frames:
        """The frames that arrived; () where none did in time. Raises `LinkLost`."""
        return self.codec.feed(self._inner.read())

    def write(self, data: Frames) -> None:
        """Hand over all frames. Raises `LinkLost`."""
        self._inner.write(b"".join(map(line_of, data)))

    def close(self) -> None:
        """Let go of the port; may be called twice."""
        self._inner.close()
