"""A bus object of the mock layer behind an adapter of the guest's own I2C core (module/wires.c)."""

import errno
import fcntl
import os
import select
import struct
import threading
from pathlib import Path
from typing import Any

from smbus2 import i2c_msg

DEVICE = Path("/dev/wires")
ADAPTER_NUMBER = 0x7701
READ = 1
HEAD, LINE = struct.Struct("<II"), struct.Struct("<HHHH")


class WiresBus:
    """Serves `bus` (an object with smbus2's `i2c_rdwr`) as /dev/i2c-N until `close`: the adapter pulled out."""

    def __init__(self, bus: Any) -> None:
        self._bus = bus
        self._fd = os.open(DEVICE, os.O_RDWR)
        self.path = f"/dev/i2c-{fcntl.ioctl(self._fd, ADAPTER_NUMBER)}"
        self._wake, self._waker = os.pipe()
        self._thread = threading.Thread(target=self._serve, name="wires-bus", daemon=True)
        self._thread.start()
        for _ in range(1000):
            if Path(self.path).exists():
                return
            threading.Event().wait(0.01)
        raise TimeoutError(self.path)

    def close(self) -> None:
        """The adapter is gone; may be called twice."""
        if not self._thread.is_alive():
            return
        os.write(self._waker, b"x")
        self._thread.join()
        os.close(self._wake)
        os.close(self._waker)

    def _serve(self) -> None:
        try:
            while self._wake not in select.select([self._fd, self._wake], [], [])[0]:
                os.write(self._fd, self._answer(os.read(self._fd, 1 << 19)))
        finally:
            os.close(self._fd)

    def _answer(self, request: bytes) -> bytes:
        ticket, count = HEAD.unpack_from(request)
        at, messages = HEAD.size + count * LINE.size, []
        for k in range(count):
            address, flags, length, _ = LINE.unpack_from(request, HEAD.size + k * LINE.size)
            if flags & READ:
                messages.append(i2c_msg.read(address, length))
            else:
                messages.append(i2c_msg.write(address, request[at: at + length]))
                at += length
        try:
            self._bus.i2c_rdwr(*messages)
        except OSError as error:
            return struct.pack("<Ii", ticket, -(error.errno or errno.EIO))
        return struct.pack("<Ii", ticket, count) + b"".join(bytes(m) for m in messages if m.flags & READ)
