"""A bus object of the mock layer behind an adapter of the guest's own I2C core (module/wires.c)."""

import errno
import fcntl
import os
import struct
from pathlib import Path
from typing import Any

from tests.kernel.served_bus import ServedBus

DEVICE = Path("/dev/wires")
ADAPTER_NUMBER = 0x7701
HEAD, LINE = struct.Struct("<II"), struct.Struct("<HHH2x")


class WiresBus(ServedBus):
    """By the next number that is free."""

    def __init__(self, bus: Any) -> None:
        super().__init__(bus, DEVICE)
        self.path = f"/dev/i2c-{fcntl.ioctl(self._fd, ADAPTER_NUMBER)}"
        self.start()

    def _answer(self, request: bytes) -> None:
        ticket, count = HEAD.unpack_from(request)
        data = HEAD.size + count * LINE.size
        try:
            read = self.transfer(list(LINE.iter_unpack(request[HEAD.size:data])), request[data:])
        except OSError as error:
            count, read = -(error.errno or errno.EIO), b""
        os.write(self._fd, struct.pack("<Ii", ticket, count) + read)
