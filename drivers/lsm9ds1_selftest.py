"""The LSM9DS1's built-in self-test: each sensor is deflected electrically, and must move by what ST's limits say.

Procedure and limits are those of ST's example for the chip: settings of the limits, a wait, five readings averaged
without and five with the deflection. The chip must lie still meanwhile, and needs its driver's `open` afterwards.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers import lsm9ds1_mag as mag
from drivers import lsm9ds1_registers as reg
from drivers.errors import DeviceFault
from drivers.i2c_bus import I2CBus, claim, explain, read_registers, write_register

READINGS = 5
READY_TIMEOUT_S = 0.5
ODR_119 = 3 << 5


class Limits(NamedTuple):
    """Limits of the deflection of each axis."""

    sensor: str
    unit: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    wait_s: float


ACCEL = Limits("accelerometer", "mg", (70.0,) * 3, (1500.0,) * 3, 0.2)
GYRO = Limits("gyroscope", "dps", (200.0,) * 3, (800.0,) * 3, 0.8)
MAG = Limits("magnetometer", "mG", (1000.0, 1000.0, 100.0), (3000.0, 3000.0, 1000.0), 0.06)


class Deflection(NamedTuple):
    """One sensor's outcome."""

    limits: Limits
    moved: tuple[float, float, float]
    """Shift of each axis, in the limits' unit."""

    @property
    def passed(self) -> bool:
        """Every axis within its limits."""
        return all(low <= value <= high for low, value, high in zip(self.limits.low, self.moved, self.limits.high))

    def __str__(self) -> str:
        axes = ", ".join(f"{axis} {value:.0f} ({low:.0f} to {high:.0f})" for axis, value, low, high in
                         zip("xyz", self.moved, self.limits.low, self.limits.high))
        return f"{self.limits.sensor} {'passed' if self.passed else 'FAILED'}: {axes} {self.limits.unit}"


class SelfTest:
    """Runs the tests on one bus. Raises `DriverError`s as the drivers do."""

    def __init__(self, bus: I2CBus, sleep: Callable[[float], None] = time.sleep,
                 now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._bus, self._sleep, self._now_ns = bus, sleep, now_ns

    def inertial(self, address: int = 0x6B) -> tuple[Deflection, Deflection]:
        """(accelerometer, gyroscope), at 2 g, 2000 dps and 119 Hz."""
        where = f"LSM9DS1 at 0x{address:02X}"
        try:
            claim(self._bus, address)
            settings = ((reg.FIFO_CTRL, 0), (reg.CTRL_REG9, 0), (reg.CTRL_REG8, reg.BDU | reg.IF_ADD_INC),
                        (reg.CTRL_REG4, 0x38), (reg.CTRL_REG5_XL, 0x38), (reg.CTRL_REG10, 0),
                        (reg.CTRL_REG6_XL, ODR_119 | reg.ACCEL_FS_CODE[2] << 3),
                        (reg.CTRL_REG1_G, ODR_119 | reg.GYRO_FS_CODE[2000] << 3))
            for register, value in settings:
                write_register(self._bus, address, register, value)
            found = []
            for limits, bit, ready, out, lsb in (
                    (ACCEL, reg.ST_XL, reg.XLDA, reg.OUT_X_L_XL, reg.ACCEL_MG_PER_LSB[2]),
                    (GYRO, reg.ST_G, reg.GDA, reg.OUT_X_L_G, reg.GYRO_MDPS_PER_LSB[2000] * 1e-3)):
                found.append(self._deflect(limits, address, (reg.CTRL_REG10, bit, 0), (reg.STATUS, ready), out, lsb))
        except OSError as error:
            raise explain(error, where) from error
        return found[0], found[1]

    def magnetic(self, address: int = 0x1E) -> Deflection:
        """The magnetometer, at 12 gauss and 80 Hz."""
        try:
            claim(self._bus, address)
            plain = mag.TEMP_COMP | mag.ULTRA_HIGH_XY | mag.MAG_ODR_HZ[80.0] << 2
            for register, value in ((mag.CTRL_REG1, plain), (mag.CTRL_REG2, mag.FS_CODE[12] << 5),
                                    (mag.CTRL_REG4, mag.ULTRA_HIGH_Z), (mag.CTRL_REG5, mag.BDU),
                                    (mag.CTRL_REG3, mag.CONTINUOUS)):
                write_register(self._bus, address, register, value)
            return self._deflect(MAG, address, (mag.CTRL_REG1, plain | mag.SELF_TEST, plain),
                                 (mag.STATUS, mag.DATA_READY), mag.OUT_X_L | mag.AUTO_INCREMENT, mag.MGAUSS_PER_LSB[12])
        except OSError as error:
            raise explain(error, f"LSM9DS1 magnetometer at 0x{address:02X}") from error

    def _deflect(self, limits: Limits, address: int, switch: tuple[int, int, int], ready: tuple[int, int], out: int,
                 lsb: float) -> Deflection:
        """Mean without, then with the deflection; `switch` is (register, value on, value off)."""
        register, on, off = switch
        self._sleep(limits.wait_s)
        before = self._mean(address, ready, out)
        write_register(self._bus, address, register, on)
        try:
            self._sleep(limits.wait_s)
            moved = np.abs(self._mean(address, ready, out) - before) * lsb
        finally:
            write_register(self._bus, address, register, off)
        x, y, z = moved.tolist()
        return Deflection(limits, (x, y, z))

    def _mean(self, address: int, ready: tuple[int, int], out: int) -> NDArray[np.float64]:
        """(3,) mean of five fresh readings [LSB], after one that may be of before."""
        readings = [self._fresh(address, ready, out) for _ in range(READINGS + 1)]
        mean: NDArray[np.float64] = np.mean(readings[1:], axis=0)
        return mean

    def _fresh(self, address: int, ready: tuple[int, int], out: int) -> NDArray[np.int16]:
        register, bit = ready
        deadline = self._now_ns() + round(READY_TIMEOUT_S * 1e9)
        while not read_registers(self._bus, address, register, 1)[0] & bit:
            if self._now_ns() > deadline:
                raise DeviceFault(f"LSM9DS1 at 0x{address:02X}: no new reading within {READY_TIMEOUT_S:g} s; "
                                  "power-cycle the chip")
            self._sleep(0.002)
        return np.frombuffer(read_registers(self._bus, address, out, 6), "<i2")
