"""The I2C bus as smbus2 offers it, and what its errors mean to a person."""

from __future__ import annotations

import errno
import fcntl
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeVar

from smbus2 import SMBus, i2c_msg

from drivers.errors import DeviceAbsent, DeviceBusy, DriverError
from drivers.exclusive import lock_byte
from drivers.i2c_socket import SocketBus


class I2CBus(Protocol):
    """Interface of a bus: combined transfers. `smbus2.SMBus` is one, the mock another."""

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """Transfer the `smbus2.i2c_msg`s in one transaction; read messages are filled. Raises OSError."""

    def close(self) -> None:
        """Let go of the bus."""


T = TypeVar("T")
RETRIES = 3
BACKOFF_S = 0.002
I2C_SLAVE = 0x0703
"""ioctl of linux/i2c-dev.h; I2C_SLAVE_FORCE, which would take the chip away, is never used."""

_MEANING: dict[int, tuple[type[DriverError], str]] = {
    errno.ENODEV: (DeviceAbsent, "no device answers; check wiring, power and address"),
    errno.EREMOTEIO: (DeviceAbsent, "no acknowledge; check wiring, power, address and pull-ups"),
    errno.ENXIO: (DeviceAbsent, "no device answers; check wiring, power and address"),
    errno.EIO: (DeviceAbsent, "bus error; check wiring, pull-ups and the bus clock"),
    errno.ETIMEDOUT: (DeviceAbsent, "the bus hangs, its clock or data line is held low; power-cycle the chip"),
    errno.EAGAIN: (DeviceAbsent, "arbitration lost; another master or noise on the bus, check wiring"),
    errno.ECONNABORTED: (DeviceAbsent, "the bus adapter is gone; plug it in again"),
    errno.ENOTCONN: (DeviceAbsent, "the bus adapter is gone; plug it in again"),
    errno.EOPNOTSUPP: (DriverError, "this adapter makes no combined transfers (I2C_RDWR); use another bus"),
    errno.EUSERS: (DeviceBusy, "another program reads the chip, legid record or calibrate perhaps; close it"),
    errno.EBUSY: (DeviceBusy, "a kernel driver holds the chip; unbind it or drop its device-tree overlay "
                              "(it is never taken by force)"),
}


def explain(error: OSError, where: str) -> DriverError:
    """The bus error as an exception with a line for a person; `where` names chip, address and bus."""
    kind, why = _MEANING.get(error.errno or 0, (DriverError, f"bus error ({error})"))
    return kind(f"{where}: {why} [errno {error.errno}]")


def open_bus(path: str, device: str = "imu") -> I2CBus:
    """The bus at `path`: `/dev/i2c-1`, or the socket of an emulated one. Raises `DeviceAbsent` naming the remedy, for
    which `device` is the table of rig.toml that names the bus."""
    if Path(path).is_socket():
        try:
            return SocketBus(path)
        except OSError as error:
            raise DeviceAbsent(f"I2C bus {path}: nobody serves this socket ({error.strerror}); start the emulated rig "
                               "again") from error
    bus = SMBus()
    try:
        bus.open(path)
    except FileNotFoundError as error:
        raise DeviceAbsent(f"I2C bus {path}: no such bus; enable I2C (raspi-config, dtparam=i2c_arm=on) or correct "
                           f"[devices.{device}] bus") from error
    except PermissionError as error:
        raise DeviceAbsent(f"I2C bus {path}: permission denied; add the user to group i2c") from error
    except OSError as error:
        bus.close()
        raise DeviceAbsent(f"I2C bus {path}: cannot be opened as an I2C bus ({error.strerror})") from error
    return bus


def claim(bus: I2CBus, address: int) -> None:
    """Take the chip for this bus handle alone, until it is closed: OSError EUSERS where another program has it, EBUSY
    where a driver of the kernel's own does. A bus within this process passes.

    A combined transfer alone would not tell: the kernel lets it through to a chip that its driver is using.
    """
    handle = getattr(bus, "fd", None)
    if isinstance(handle, int):
        fcntl.ioctl(handle, I2C_SLAVE, address)
        lock_byte(handle, address)
    elif isinstance(bus, SocketBus):
        bus.lock(address)


def with_retries(work: Callable[[], T], sleep: Callable[[float], None]) -> T:
    """`work`, once and up to three times more; the last OSError comes through. A busy chip is not tried again."""
    for attempt in range(RETRIES):
        try:
            return work()
        except OSError as error:
            if error.errno == errno.EBUSY:
                raise
            sleep(BACKOFF_S * 2**attempt)
    return work()


def read_registers(bus: I2CBus, address: int, register: int, count: int) -> bytes:
    """`count` bytes from `register` on: one write and one read message, the only shape every adapter takes."""
    reply = i2c_msg.read(address, count)
    bus.i2c_rdwr(i2c_msg.write(address, [register]), reply)
    return bytes(reply)


def write_register(bus: I2CBus, address: int, register: int, value: int) -> None:
    """One byte into one register."""
    write_registers(bus, address, register, bytes([value]))


def write_registers(bus: I2CBus, address: int, register: int, data: bytes) -> None:
    """Bytes from `register` on, in one message."""
    bus.i2c_rdwr(i2c_msg.write(address, [register, *data]))
