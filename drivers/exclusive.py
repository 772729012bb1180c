"""Locks on devices that the kernel shares among all who open them. They end with the process that holds them."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import struct
import sys


def lock_byte(descriptor: int, offset: int) -> None:
    """Lock one byte of an open device node: an I2C bus by the chip's address.

    The lock belongs to this opening of the node and goes with it. Raises OSError EUSERS where somebody else has it.
    """
    if not hasattr(fcntl, "F_OFD_SETLK"):  # not Linux, where there is no such node either
        return
    request = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, offset, 1, 0)
    try:
        fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, request)
    except OSError as error:
        raise _taken(error) from None


def lock_file(path: str) -> int:
    """An open descriptor of the file at `path`, locked. Raises OSError EUSERS where somebody else has it."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise _taken(error) from None
    return descriptor


def lock_name(name: str) -> socket.socket | None:
    """A name that one process of this network namespace holds until it closes the socket: for what has no node, as a
    CAN interface, whose namespace is the same. None where the system has none. Raises OSError EUSERS."""
    if not sys.platform.startswith("linux"):
        return None
    held = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        held.bind(f"\0legid/{name}"[:100])
    except OSError as error:
        held.close()
        raise _taken(error) from None
    return held


def _taken(error: OSError) -> OSError:
    held = error.errno in (errno.EAGAIN, errno.EACCES, errno.EADDRINUSE)
    return OSError(errno.EUSERS, os.strerror(errno.EUSERS)) if held else error
