"""`open_port`: the transport that a port's name asks for; a new transport is a file in this folder."""

from __future__ import annotations

import re
from importlib import import_module
from importlib.util import find_spec

from drivers.errors import DeviceAbsent
from drivers.link import Link
from drivers.serial_link import SerialLink

NAMED = re.compile(r"([a-z][a-z0-9]*)://(.*)")
"""A transport, and where it leads; anything else is a serial port."""


def open_port(port: str, baud: int) -> Link[bytes]:
    """A serial port at `baud`, or for NAME://ADDRESS what `open_link(ADDRESS)` of drivers/NAME_link.py opens.

    Raises a `DriverError`.
    """
    named = NAMED.fullmatch(port)
    if named is None:
        return SerialLink(port, baud)
    module = f"{__package__}.{named[1]}_link"
    opener = getattr(import_module(module), "open_link", None) if find_spec(module) is not None else None
    if opener is None:
        raise DeviceAbsent(f"{port}: no driver knows {named[1]}://; give a serial port, or a driver's file "
                           f"drivers/{named[1]}_link.py with a function open_link")
    link: Link[bytes] = opener(named[2])
    return link
