"""A port for makers' libraries that keeps what they write."""

from typing import Any


class RecordedPort:
    """Opened by nobody; `sent` has each packet."""

    is_using = False

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def clearPort(self) -> None:
        """Nothing has come."""

    def writePort(self, data: Any) -> int:
        """Keep a packet; the line is free again."""
        self.sent.append(bytes(data))
        self.is_using = False
        return len(data)

    def setPacketTimeout(self, length: int) -> None:
        """No answer is waited for."""
