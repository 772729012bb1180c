"""Errors of devices. One line each, for a person: device, place, remedy."""

from __future__ import annotations


class DriverError(Exception):
    """Any failure of a device or of the bus it hangs on."""


class DeviceAbsent(DriverError):
    """No device answers at the given port or address, or opening it is not permitted."""


class DeviceBusy(DriverError):
    """Somebody else holds the device: another program or a kernel driver. Never taken by force."""


class DeviceFault(DriverError):
    """The device answers and refuses to work: a latched fault, a register that does not hold its value."""


class LinkLost(DriverError):
    """The connection was there and is gone: unplugged, closed, or no longer taking bytes."""


class ProtocolMismatch(DriverError):
    """The firmware speaks another version of firmware_protocol.md."""
