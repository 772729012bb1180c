"""Our own firmware as a drive: the leg controller on a serial port, on CAN, or behind any other transport."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from drivers.drive import Wiring
from drivers.errors import DeviceAbsent
from drivers.leg_controller import LegController
from drivers.link import Link
from drivers.transport import open_port


def open_link(wiring: Wiring) -> Link[Any]:
    """The leg controller's transport. Raises a `DriverError`."""
    if wiring.can is None:
        return open_port(wiring.port, wiring.baud)
    from drivers.can_frame import NODES
    from drivers.can_link import CanLink  # python-can takes a while to load

    if wiring.node >= NODES:
        raise DeviceAbsent(f"[devices.controller] node is {wiring.node}, the leg controller's are 0 to {NODES - 1}")
    return CanLink(wiring.node, **wiring.can)


def attach(link: Link[Any], wiring: Wiring, now_ns: Callable[[], int],
           sleep: Callable[[float], None]) -> LegController:
    """The leg controller behind `link`; it waits there, never by `sleep`."""
    if wiring.can is None:
        return LegController(link, now_ns)
    from drivers.can_codec import CanCodec  # cantools takes a while to load

    return LegController(link, now_ns, CanCodec(wiring.node))
