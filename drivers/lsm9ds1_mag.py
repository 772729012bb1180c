"""LSM9DS1 magnetometer: a chip of its own on the same bus (ST DocID025715, section 8)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.errors import DeviceAbsent, DeviceFault
from drivers.i2c_bus import I2CBus, claim, explain, read_registers, write_register

WHO_AM_I, WHO_AM_I_VALUE = 0x0F, 0x3D
CTRL_REG1, CTRL_REG2, CTRL_REG3, CTRL_REG4, CTRL_REG5 = 0x20, 0x21, 0x22, 0x23, 0x24
STATUS, OUT_X_L = 0x27, 0x28
AUTO_INCREMENT = 0x80
"""Bit of the sub-address: without it every byte comes from the same register."""
TEMP_COMP, ULTRA_HIGH_XY, SELF_TEST = 0x80, 0x60, 0x01
"""Bits of CTRL_REG1_M."""
SOFT_RESET = 0x04
"""Bit of CTRL_REG2_M."""
CONTINUOUS = 0x00
"""CTRL_REG3_M."""
ULTRA_HIGH_Z = 0x0C
"""CTRL_REG4_M."""
BDU = 0x40
"""CTRL_REG5_M."""
OVERRUN, DATA_READY = 0x80, 0x08
"""Bits of STATUS_REG_M: all axes."""
MAG_ODR_HZ: dict[float, int] = {0.625: 0, 1.25: 1, 2.5: 2, 5.0: 3, 10.0: 4, 20.0: 5, 40.0: 6, 80.0: 7}
"""Rate to CTRL_REG1_M[4:2] (table 111)."""
FS_CODE: dict[int, int] = {4: 0b00, 8: 0b01, 12: 0b10, 16: 0b11}
"""Full scale [gauss] to CTRL_REG2_M[6:5]."""
MGAUSS_PER_LSB: dict[int, float] = {4: 0.14, 8: 0.29, 12: 0.43, 16: 0.58}
"""Table 3. Not full scale / 32768."""
TESLA_PER_MGAUSS = 1e-7
TO_AG = np.array([-1.0, 1.0, 1.0])
"""Its X axis opposes that of accelerometer and gyroscope; Y and Z agree (figure 1)."""
RESET_TIMEOUT_S = 0.1


@dataclass(frozen=True)
class MagConfig:
    """Rate [Hz] and full scale [gauss]; only the chip's own values."""

    rate_hz: float = 20.0
    range_gauss: int = 4

    def __post_init__(self) -> None:
        for name, value, allowed in (("rate_hz", self.rate_hz, list(MAG_ODR_HZ)),
                                     ("range_gauss", self.range_gauss, list(FS_CODE))):
            if value not in allowed:
                raise ValueError(f"LSM9DS1's magnetometer has no {name} of {value}; it has "
                                 f"{', '.join(map(str, allowed))}")

    @property
    def scale_t(self) -> float:
        """Tesla per LSB."""
        return MGAUSS_PER_LSB[self.range_gauss] * TESLA_PER_MGAUSS

    def registers(self) -> tuple[tuple[int, int], ...]:
        """(register, value) in the order in which they are written; CTRL_REG3_M last starts it."""
        return ((CTRL_REG1, TEMP_COMP | ULTRA_HIGH_XY | MAG_ODR_HZ[self.rate_hz] << 2),
                (CTRL_REG2, FS_CODE[self.range_gauss] << 5),
                (CTRL_REG4, ULTRA_HIGH_Z),
                (CTRL_REG5, BDU),
                (CTRL_REG3, CONTINUOUS))


class MagSample(NamedTuple):
    """One reading."""

    raw: NDArray[np.int16]
    """(3,) LSB, in the magnetometer's own axes."""
    host_ns: int
    """Host time after the read."""
    overrun: bool
    """A reading before this one was overwritten unread."""


class Magnetometer:
    """The magnetometer on a bus. Not thread-safe."""

    def __init__(self, bus: I2CBus, address: int = 0x1E, config: MagConfig | None = None,
                 now_ns: Callable[[], int] = time.monotonic_ns, sleep: Callable[[float], None] = time.sleep) -> None:
        self.config = config or MagConfig()
        self.where = f"LSM9DS1 magnetometer at 0x{address:02X}"
        self._bus, self._address = bus, address
        self._now_ns, self._sleep = now_ns, sleep

    def open(self) -> None:
        """Identify, reset, configure, read back. Raises `DeviceAbsent`, `DeviceBusy` or `DeviceFault`."""
        try:
            claim(self._bus, self._address)
            self._identify()
            self._reset()
            for register, value in self.config.registers():
                write_register(self._bus, self._address, register, value)
            for register, value in self.config.registers():
                self._verify(register, value)
        except OSError as error:
            raise explain(error, self.where) from error
        self.read()  # whatever was measured before these settings

    def read(self) -> MagSample | None:
        """The newest reading, None when there is none since the last. Raises `DeviceAbsent` when the chip has gone."""
        try:
            status = self._read(STATUS, 1)[0]
            if not status & DATA_READY:
                return None
            data = self._read(OUT_X_L | AUTO_INCREMENT, 6)
        except OSError as error:
            raise explain(error, self.where) from error
        return MagSample(np.frombuffer(data, "<i2").astype(np.int16), self._now_ns(), bool(status & OVERRUN))

    def close(self) -> None:
        """Let go of the bus."""
        self._bus.close()

    def _identify(self) -> None:
        who = self._read(WHO_AM_I, 1)[0]
        if who != WHO_AM_I_VALUE:
            raise DeviceAbsent(f"{self.where}: WHO_AM_I reads 0x{who:02X}, it has 0x{WHO_AM_I_VALUE:02X}; another chip "
                               "is wired there, check the address")

    def _reset(self) -> None:
        write_register(self._bus, self._address, CTRL_REG2, SOFT_RESET)
        deadline = self._now_ns() + round(RESET_TIMEOUT_S * 1e9)
        while self._read(CTRL_REG2, 1)[0] & SOFT_RESET:
            if self._now_ns() > deadline:
                raise DeviceFault(f"{self.where}: reset does not end; power-cycle the chip")
            self._sleep(0.001)

    def _verify(self, register: int, value: int) -> None:
        found = self._read(register, 1)[0]
        if found != value:
            raise DeviceFault(f"{self.where}: register 0x{register:02X} reads 0x{found:02X} after 0x{value:02X} was "
                              "written; check supply and bus clock")

    def _read(self, register: int, count: int) -> bytes:
        return read_registers(self._bus, self._address, register, count)
