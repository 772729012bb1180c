"""A bus object of the mock layer behind a real /dev/i2c-N, by the kernel's CUSE: no hardware, no library.

The driver opens the device node and makes its ioctls as on any adapter; the kernel hands them to the thread here, which
fetches the caller's messages out of its memory (struct layouts: linux/fuse.h, linux/i2c.h, linux/i2c-dev.h).
"""

import errno
import os
import struct
from pathlib import Path
from typing import Any

from tests.kernel.served_bus import READ, ServedBus

HEADER = struct.Struct("<IIQQIIIHH")  # length, opcode, unique, node, uid, gid, pid, extensions, padding
REPLY = struct.Struct("<IiQ")
IOCTL = struct.Struct("<QIIQII")  # handle, flags, command, argument, bytes in, bytes out
MESSAGE = struct.Struct("<HHH2xQ")  # address, flags, length, pointer
OPEN, RELEASE, INTERRUPT, IOCTL_OP, INIT = 14, 18, 36, 39, 4096
UNRESTRICTED = 1
RETRY = 4
I2C_SLAVE, I2C_FUNCS, I2C_RDWR = 0x0703, 0x0705, 0x0707
PLAIN_I2C = 1
MOST_MESSAGES, LONGEST = 42, 8192
Area = tuple[int, int]
"""Address and length in the caller's memory."""


class CuseBus(ServedBus):
    """As /dev/i2c-NUMBER."""

    def __init__(self, bus: Any, number: int = 7) -> None:
        super().__init__(bus, "/dev/cuse")
        self.path = f"/dev/i2c-{number}"
        self.start()

    def _answer(self, request: bytes) -> None:
        length, opcode, unique, *_ = HEADER.unpack_from(request)
        body = request[HEADER.size: length]
        error, data = 0, b""
        try:
            if opcode == INIT:
                major, minor = struct.unpack_from("<II", body)
                data = struct.pack("<6I2I40x", major, minor, 0, UNRESTRICTED, 65536, 65536, 0, 0)
                data += f"DEVNAME={Path(self.path).name}".encode() + b"\0"
            elif opcode == OPEN:
                data = struct.pack("<QII", 1, 1, 0)
            elif opcode == IOCTL_OP:
                data = self._ioctl(body)
            elif opcode == INTERRUPT:
                return
            elif opcode != RELEASE:
                error = errno.ENOSYS
        except OSError as failure:
            error = failure.errno or errno.EIO
        os.write(self._fd, REPLY.pack(REPLY.size + len(data), -error, unique) + data)

    def _ioctl(self, body: bytes) -> bytes:
        _, _, command, argument, _, room = IOCTL.unpack_from(body)
        given = body[IOCTL.size:]
        if command == I2C_SLAVE:
            return _result(0)
        if command == I2C_FUNCS:
            return _result(0, struct.pack("<Q", PLAIN_I2C)) if room else _fetch([], [(argument, 8)])
        if command == I2C_RDWR:
            return self._transfer(argument, given)
        raise OSError(errno.ENOTTY, "ioctl")

    def _transfer(self, argument: int, given: bytes) -> bytes:
        """Struct, then messages, then their buffers: the kernel is asked again until all of it is here."""
        areas = [(argument, 16)]
        if len(given) < 16:
            return _fetch(areas, [])
        pointer, count = struct.unpack_from("<QI", given)
        if not 0 < count <= MOST_MESSAGES:
            raise OSError(errno.EINVAL, "number of messages")
        areas.append((pointer, count * MESSAGE.size))
        start = 16 + count * MESSAGE.size
        if len(given) < start:
            return _fetch(areas, [])
        heads = list(MESSAGE.iter_unpack(given[16:start]))
        if any(length > LONGEST for _, _, length, _ in heads):
            raise OSError(errno.EINVAL, "length of a message")
        read, written = ([(at, length) for _, flags, length, at in heads if flags & READ == way and length]
                         for way in (READ, 0))
        if len(given) < start + sum(length for _, length in written):
            return _fetch(areas + written, read)
        return _result(count, self.transfer([head[:3] for head in heads], given[start:]))


def _fetch(into: list[Area], out: list[Area]) -> bytes:
    """Ask the kernel to call again with these areas of the caller's memory."""
    areas = b"".join(struct.pack("<QQ", *area) for area in into + out)
    return struct.pack("<iIII", 0, RETRY, len(into), len(out)) + areas


def _result(value: int, data: bytes = b"") -> bytes:
    return struct.pack("<iIII", value, 0, 0, 0) + data
