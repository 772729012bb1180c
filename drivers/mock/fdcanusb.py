"""An fdcanusb before an emulated drive: lines of text in, frames on, and back."""

from __future__ import annotations

from typing import Any

from drivers.can_frame import CanFrame, padded
from drivers.fdcanusb_link import checked, checksum
from drivers.mock.link import SerialDevice

NOP = 0x50
"""The adapter fills frames up to a length that CAN FD has."""


class MockFdcanusb:
    """A `SerialDevice` of bytes around one of frames."""

    def __init__(self, device: SerialDevice) -> None:
        self._device = device
        self._rest = b""
        self._sums = False
        """Lines carry checksums, as those of who asks do: so a moteus speaks on its own UART."""
        self._answers: list[tuple[int, bytes]] = []

    def receive(self, data: bytes, t_ns: int) -> None:
        """Bytes that are there now."""
        self._take(data, t_ns, self._device.receive)

    def post(self, data: bytes, t_ns: int) -> None:
        """Bytes under way that will be there at `t_ns`."""
        self._take(data, t_ns, self._device.post)

    def transmit(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Bytes that left the adapter up to `until_ns`."""
        out, self._answers = self._answers, []
        for t_ns, frames in self._device.transmit(until_ns):
            lines = b"".join(self._line(f"rcv {f.can_id:x} {f.data.hex().upper()} {'E' if f.extended else 'e'} B F")
                             for f in frames)
            out.append((t_ns, lines))
        return sorted(out, key=lambda item: item[0])

    def _line(self, text: str) -> bytes:
        data = text.encode()
        return (data + b" *%02X\r\n" % checksum(data + b" ")) if self._sums else data + b"\r\n"

    def _take(self, data: bytes, t_ns: int, hand_on: Any) -> None:
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            try:
                words = checked(line.strip()).split()
                self._sums = b"*" in line
                if not words:
                    continue
                if words[:2] != [b"can", b"send"]:
                    raise ValueError
                identifier, payload = int(words[2], 16), bytes.fromhex(words[3].decode("ascii") if words[3:] else "")
                frame = CanFrame(identifier, padded(payload, NOP), identifier > 0x7FF, True)
            except (ValueError, IndexError):
                self._answers.append((t_ns, self._line("ERR unknown command")))
                continue
            self._answers.append((t_ns, self._line("OK")))
            hand_on((frame,), t_ns)
