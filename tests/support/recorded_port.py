"""Ports for makers' libraries: one that keeps what they write, and one to emulated servos."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from drivers import Wiring
from drivers.mock import MockRig, PtyServer, RealClock, drive_facts, drive_maker
from tests.support.still_plant import StillPlant, StillState


@contextmanager
def servo_line(kind: str, other: bytearray, sdk: Any) -> Iterator[tuple[Any, Any]]:
    """An emulated servo by the number 3, turned by 1 rad; `other` is the table of number 4 on its line. With the
    library's port."""
    wiring = Wiring(node=3, rate_hz=drive_facts(kind).rate_hz)
    rig = MockRig(StillPlant(StillState(q2=1.0)), RealClock(), make=drive_maker(kind, wiring))
    drive: Any = rig.drive
    drive.others[4] = other
    with PtyServer(drive, rig.clock) as server:
        port = sdk.PortHandler(server.path)
        assert port.openPort()
        yield drive, port
        port.closePort()


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
