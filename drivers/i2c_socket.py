"""An I2C bus behind a unix socket: where a rig file's `bus` is a socket, another process does the transfers.

One packet a transaction. Request, little endian: the number of messages, and for each its address (u16), 1 for a read
or 0 (u8), its length (u16) and the bytes of a write. Reply: errno (u16, 0 for none), then the bytes of all reads.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
import threading
from collections.abc import Iterator
from typing import Any

from drivers.exclusive import lock_file

MESSAGE = struct.Struct("<HBH")
REPLY = struct.Struct("<H")
PACKET_BYTES = 65536
TIMEOUT_S = 2.0


class SocketBus:
    """The near end: what `smbus2.SMBus` is for a bus of this machine."""

    def __init__(self, path: str) -> None:
        """Raises OSError where nobody serves the socket."""
        self._lock = threading.Lock()
        self._path = path
        self._held: dict[int, int] = {}
        self._late = False
        """A request was given up: its reply may come yet, and must not pass for the next one's."""
        self._socket = _connected(path)

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """One transaction of `smbus2.i2c_msg`s. Raises the OSError of the far end, ENODEV when that has gone."""
        try:
            with self._lock:
                if self._late:
                    self._socket.close()
                    self._socket = _connected(self._path)
                self._late = True
                self._socket.send(pack(i2c_msgs))
                reply = self._socket.recv(PACKET_BYTES)
                self._late = False
        except TimeoutError:
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT)) from None
        except OSError:
            reply = b""
        if not reply:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        (number,) = REPLY.unpack_from(reply)
        if number:
            raise OSError(number, os.strerror(number))
        at = REPLY.size
        if len(reply) != at + sum(message.len for message in i2c_msgs if message.flags & 1):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        for message in i2c_msgs:
            if message.flags & 1:
                for i in range(message.len):
                    message.buf[i] = reply[at + i:at + i + 1]
                at += message.len

    def lock(self, address: int) -> None:
        """Take the chip at this address until `close`. Raises OSError EUSERS where another program has it."""
        if address not in self._held:
            self._held[address] = lock_file(f"{self._path}-{address:02x}.lock")

    def close(self) -> None:
        """Let go of the far end; may be called twice."""
        self._socket.close()
        while self._held:
            os.close(self._held.popitem()[1])


def _connected(path: str) -> socket.socket:
    found = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    found.settimeout(TIMEOUT_S)
    try:
        found.connect(path)
    except OSError:
        found.close()
        raise
    return found


def pack(messages: Any) -> bytes:
    """The request for a transaction."""
    parts = [bytes([len(messages)])]
    for message in messages:
        read = message.flags & 1
        parts += [MESSAGE.pack(message.addr, read, message.len), b"" if read else bytes(message)]
    return b"".join(parts)


def unpack(request: bytes) -> Iterator[tuple[int, bool, int, bytes]]:
    """(address, is a read, length, bytes written) of each message of a request. Raises ValueError."""
    at = 1
    for _ in range(request[0] if request else 0):
        if len(request) < at + MESSAGE.size:
            raise ValueError("request cut short")
        address, read, length = MESSAGE.unpack_from(request, at)
        at += MESSAGE.size
        data = b"" if read else request[at:at + length]
        at += len(data)
        if not read and len(data) < length:
            raise ValueError("request cut short")
        yield address, bool(read), length, data
