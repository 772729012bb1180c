"""LSM9DS1 gyroscope and accelerometer over I2C: configure, run the FIFO, drain it in bursts.

Both sensors run at one rate into the 32-deep FIFO in continuous mode. One burst from 0x18 carries all unread
samples, because the address jumps 1D to 28 and wraps 2D to 18 (section 3.3). What a burst failed to bring is a gap:
the chip has popped some of it and nobody knows how much, so nothing is read twice.

The driver is a state machine, one step a tick: RESET, WAIT for its end, CONFIGURE, READ. While reading, one register is
compared with its setting every 100 ms; a chip that forgot, or failed repeatedly, is reset and configured anew.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers import lsm9ds1_registers as reg
from drivers.errors import DeviceAbsent, DeviceBusy, DeviceFault, DriverError
from drivers.i2c_bus import I2CBus, claim, explain, open_bus, read_registers, with_retries, write_register
from drivers.lsm9ds1_mag import Magnetometer
from drivers.lsm9ds1_registers import ACCEL_MG_PER_LSB, GYRO_MDPS_PER_LSB, ODR_HZ

__all__ = ["ACCEL_MG_PER_LSB", "GYRO_MDPS_PER_LSB", "ODR_HZ", "I2CBus", "ImuBatch", "ImuConfig", "Lsm9ds1", "open_bus"]

T = TypeVar("T")
RESET_TIMEOUT_S = 0.1
BUS_SHARE = 0.7
"""Share of the bus that samples may take; the rest is addresses, status reads and retries."""
RATE_TOLERANCE = 0.06
"""How far the chip's oscillator may be fast, when judging whether the FIFO can have overflowed."""
CHECK_EVERY_NS = 100_000_000
FORGOT = "FIFO found switched off, chip configured anew"
GIVE_UP_AFTER = 5
"""Failed attempts in a row to bring the chip back, each with its retries, after which it counts as gone."""


class Phase(Enum):
    """Phase of the driver's start of its chip."""

    RESET = "reset"
    WAIT = "wait"
    CONFIGURE = "configure"
    READ = "read"


@dataclass(frozen=True)
class ImuConfig:
    """Rate [Hz] and full scales [g], [dps]; only the chip's own values."""

    rate_hz: float = 238.0
    accel_range_g: int = 4
    gyro_range_dps: int = 500

    def __post_init__(self) -> None:
        choices: list[tuple[str, float, list[float]]] = [
            ("rate_hz", self.rate_hz, list(ODR_HZ)),
            ("accel_range_g", self.accel_range_g, list(ACCEL_MG_PER_LSB)),
            ("gyro_range_dps", self.gyro_range_dps, list(GYRO_MDPS_PER_LSB))]
        for name, value, allowed in choices:
            if value not in allowed:
                raise ValueError(f"LSM9DS1 has no {name} of {value}; it has {', '.join(map(str, allowed))}")

    @property
    def scale(self) -> tuple[float, float]:
        """(gyro [rad/s per LSB], accelerometer [m/s2 per LSB]), from the datasheet's table 3."""
        return (math.radians(GYRO_MDPS_PER_LSB[self.gyro_range_dps] * 1e-3),
                ACCEL_MG_PER_LSB[self.accel_range_g] * 1e-3 * reg.STANDARD_GRAVITY)

    @property
    def cutoffs_hz(self) -> tuple[float, float]:
        """(gyro, accelerometer) -3 dB points of the low passes that `registers` sets."""
        return reg.GYRO_CUTOFF_HZ[self.rate_hz], reg.ACCEL_CUTOFF_HZ[self.rate_hz]

    def registers(self) -> tuple[tuple[int, int], ...]:
        """(register, value) in the order in which they are written; FIFO_CTRL last starts the FIFO."""
        odr = ODR_HZ[self.rate_hz] << 5
        return ((reg.CTRL_REG8, reg.BDU | reg.IF_ADD_INC),
                (reg.CTRL_REG4, 0x38),  # three gyro axes on
                (reg.CTRL_REG5_XL, 0x38),  # three accelerometer axes on, no decimation
                (reg.CTRL_REG2_G, 0x00),  # gyro straight from LPF1: least delay
                (reg.CTRL_REG3_G, 0x00),  # no high-pass: it would eat slow swings
                (reg.CTRL_REG6_XL, odr | reg.ACCEL_FS_CODE[self.accel_range_g] << 3),
                (reg.CTRL_REG7_XL, 0x00),
                (reg.CTRL_REG1_G, odr | reg.GYRO_FS_CODE[self.gyro_range_dps] << 3),
                (reg.CTRL_REG9, reg.FIFO_EN),
                (reg.FIFO_CTRL, reg.FIFO_CONTINUOUS))


@dataclass(frozen=True)
class ImuBatch:
    """The samples of one drain, oldest first."""

    raw: NDArray[np.int16]
    """(n, 6) LSB: gyro x y z, accelerometer x y z, in the chip's axes. n may be 0."""
    t_before_ns: int
    t_after_ns: int
    """Host time around the read of the fill level: the newest sample of the batch was latched before
    `t_after_ns`, the one that follows it after `t_before_ns`."""
    first_index: int
    """Running count of the batch's first sample since `open`, as far as known: a gap counts as nothing."""
    gap_before: bool
    """An unknown number of samples was lost between the batch before and this one."""
    reason: str
    """Why there is a gap, for a person; empty without one."""


class Lsm9ds1:
    """One chip on a bus. Not thread-safe: one thread drains it."""

    def __init__(self, bus: I2CBus, address: int = 0x6B, config: ImuConfig | None = None,
                 now_ns: Callable[[], int] = time.monotonic_ns, bus_khz: float = 400.0,
                 sleep: Callable[[float], None] = time.sleep) -> None:
        self.config = config or ImuConfig()
        self.magnetometer: Magnetometer | None = None
        """The package's other chip, where it is used."""
        self.where = f"LSM9DS1 at 0x{address:02X}"
        self.bus, self._address, self._bus_khz = bus, address, bus_khz
        self._now_ns, self._sleep = now_ns, sleep
        self._index = 0
        self._gap = ""
        self._settling = 0
        self._phase = Phase.RESET
        self._failures = 0
        self._reset_until = 0
        self._check_at, self._check_next = 0, 0

    @property
    def scale(self) -> tuple[float, float]:
        """(gyro [rad/s per LSB], accelerometer [m/s2 per LSB])."""
        return self.config.scale

    def open(self) -> None:
        """Identify, reset, configure, read back, start the FIFO, and wait until the sensors have settled.

        Raises ValueError when the bus is too slow for the rate, `DeviceAbsent`, `DeviceBusy` or `DeviceFault`.
        """
        self._check_bus_speed()
        self._phase = Phase.RESET
        try:
            claim(self.bus, self._address)
            while self._phase is not Phase.READ:
                self._retry(self._step)
                if self._phase is Phase.WAIT:
                    self._sleep(0.001)
        except OSError as error:
            raise explain(error, self.where) from error
        deadline = self._now_ns() + round((4 * reg.SETTLE_SAMPLES / self.config.rate_hz + 0.2) * 1e9)
        while self._settling:
            self._sleep(2 / self.config.rate_hz)
            self.drain()
            if self._now_ns() > deadline:
                raise DeviceFault(f"{self.where}: configured, but its FIFO stays empty; power-cycle the chip")
        self._index, self._gap = 0, ""

    def drain(self) -> ImuBatch:
        """One tick: all unread samples, or a step towards reading again.

        Bus errors are retried, then the FIFO is restarted, then the chip is reset; all of that becomes a gap.
        Raises `DeviceAbsent`, `DeviceBusy` or `DeviceFault` when the chip does not come back.
        """
        if self._phase is not Phase.READ:
            return self._come_back()
        self._check_one_register()
        if self._phase is Phase.READ:
            try:
                batch = self._retry(self._drain_once)
                self._failures = 0
                return batch
            except OSError as error:
                self._restart(f"bus errors [errno {error.errno}], FIFO restarted")
        return self._nothing()

    def temperature(self) -> float:
        """Chip temperature [degC]; only its changes mean anything, its offset may be tens of degrees."""
        try:
            data = self._retry(lambda: self._read(reg.OUT_TEMP_L, 2))
        except OSError as error:
            raise explain(error, self.where) from error
        lsb = int.from_bytes(data, "little", signed=True)
        return reg.TEMPERATURE_ZERO_DEGC + lsb / reg.TEMPERATURE_LSB_PER_DEGC

    def close(self) -> None:
        """Let go of the bus."""
        self.bus.close()

    # -- the steps -----------------------------------------------------------------------------------------

    def _drain_once(self) -> ImuBatch:
        t_before = self._now_ns()
        control, source = self._read(reg.FIFO_CTRL, 2)
        t_after = self._now_ns()
        if control != reg.FIFO_CONTINUOUS:
            return self._forgot()
        count = min(source & reg.FIFO_FSS, reg.FIFO_DEPTH)
        if source & reg.FIFO_OVRN:
            self._gap = "FIFO overrun: drained too late"
        raw = np.empty((0, 6), np.int16)
        if count:
            raw, control = self._burst(count, t_before)
            if control != reg.FIFO_CONTINUOUS:
                return self._forgot()
        if self._settling:
            dropped = min(self._settling, count)
            self._settling -= dropped
            raw = raw[dropped:]
        gap, self._gap = (self._gap, "") if len(raw) else ("", self._gap)
        batch = ImuBatch(raw, t_before, t_after, self._index, bool(gap), gap)
        self._index += len(raw)
        return batch

    def _forgot(self) -> ImuBatch:
        """The chip has lost its settings: it is configured anew from the next tick on, which is a gap."""
        self._gap, self._phase = FORGOT, Phase.RESET
        return self._nothing()

    def _nothing(self) -> ImuBatch:
        now = self._now_ns()
        return ImuBatch(np.empty((0, 6), np.int16), now, now, self._index, False, "")

    def _burst(self, count: int, t_level_ns: int) -> tuple[NDArray[np.int16], int]:
        """(count, 6) samples in one transfer, and FIFO_CTRL after it. On a bus error the batch is lost, a gap noted.

        A chip that lost its supply meanwhile answers the burst all the same, with numbers that mean nothing.
        """
        size = count * reg.SAMPLE_BYTES
        try:
            data = self._read(reg.OUT_X_L_G, size)
            waited_s = (self._now_ns() - t_level_ns) * 1e-9 - size * 9 / (self._bus_khz * 1e3)
            control = self._retry(lambda: self._read(reg.FIFO_CTRL, 1))[0]
        except OSError as error:
            self._gap = f"burst broke off [errno {error.errno}]"
            raise
        # The chip samples on between the level and the burst: had this thread slept there, the oldest are gone.
        if count + waited_s * self.config.rate_hz * (1 + RATE_TOLERANCE) > reg.FIFO_DEPTH:
            self._gap = self._gap or "stalled between fill level and burst: FIFO may have overrun"
        return np.frombuffer(data, "<i2").astype(np.int16).reshape(count, 6), control

    def _step(self) -> None:
        """One step of the state machine towards READ."""
        if self._phase is Phase.RESET:
            self._identify()
            self._write(reg.CTRL_REG8, reg.SW_RESET | reg.IF_ADD_INC)
            self._reset_until = self._now_ns() + round(RESET_TIMEOUT_S * 1e9)
            self._phase = Phase.WAIT
        elif self._phase is Phase.WAIT:
            if not self._read(reg.CTRL_REG8, 1)[0] & (reg.SW_RESET | reg.BOOT):
                self._phase = Phase.CONFIGURE
            elif self._now_ns() > self._reset_until:
                self._phase = Phase.RESET
                raise DeviceFault(f"{self.where}: reset does not end; power-cycle the chip")
        elif self._phase is Phase.CONFIGURE:
            for register, value in self.config.registers():
                self._write(register, value)
            for register, value in self.config.registers():
                self._verify(register, value)
            self._settling = reg.SETTLE_SAMPLES
            self._check_at = self._now_ns() + CHECK_EVERY_NS
            self._phase = Phase.READ

    def _come_back(self) -> ImuBatch:
        """A step towards READ that may fail some times before it counts."""
        try:
            self._retry(self._step)
        except OSError as error:
            self._failed(explain(error, self.where))
        except DeviceFault as error:
            self._failed(error)
        return self._nothing()

    def _failed(self, error: DriverError) -> None:
        """Start over from RESET; too often in a row, or from a chip that is another's, it is the end."""
        self._phase = Phase.RESET
        self._failures += 1
        if self._failures >= GIVE_UP_AFTER or isinstance(error, DeviceBusy):
            raise error

    def _identify(self) -> None:
        who = self._read(reg.WHO_AM_I, 1)[0]
        if who != reg.WHO_AM_I_VALUE:
            raise DeviceAbsent(f"{self.where}: WHO_AM_I reads 0x{who:02X}, an LSM9DS1 has "
                               f"0x{reg.WHO_AM_I_VALUE:02X}; another chip is wired there, check the address")

    def _verify(self, register: int, value: int) -> None:
        found = self._read(register, 1)[0]
        if found != value:
            raise DeviceFault(f"{self.where}: register 0x{register:02X} reads 0x{found:02X} after 0x{value:02X} was "
                              "written; check supply and bus clock")

    def _check_one_register(self) -> None:
        """One register in turn every 100 ms: a chip that browned out looks alive and has lost its settings."""
        if self._now_ns() < self._check_at:
            return
        self._check_at = self._now_ns() + CHECK_EVERY_NS
        registers = self.config.registers()
        register, value = registers[self._check_next % len(registers)]
        self._check_next += 1
        try:
            found = self._retry(lambda: self._read(register, 1))[0]
        except OSError as error:
            self._restart(f"bus errors [errno {error.errno}], FIFO restarted")
            return
        if found != value:
            self._gap, self._phase = f"register 0x{register:02X} lost its value, chip configured anew", Phase.RESET

    def _restart(self, why: str) -> None:
        """Empty the FIFO and look all registers through; reset when one is wrong or nobody answers. Notes a gap."""
        self._gap = why
        try:
            self._retry(self._flush)
            if not self._retry(self._holds_settings):
                self._phase = Phase.RESET
            self._settling = 1  # the first sample after a FIFO mode change is not good
        except OSError as error:
            self._failed(explain(error, self.where))

    def _holds_settings(self) -> bool:
        return all(self._read(register, 1)[0] == value for register, value in self.config.registers())

    def _flush(self) -> None:
        self._write(reg.FIFO_CTRL, reg.FIFO_BYPASS)
        self._write(reg.FIFO_CTRL, reg.FIFO_CONTINUOUS)

    def _check_bus_speed(self) -> None:
        need = self.config.rate_hz * reg.SAMPLE_BYTES * 9 / 1e3
        if need > BUS_SHARE * self._bus_khz:
            raise ValueError(f"{self.where}: {self.config.rate_hz:g} Hz needs {need:.0f} kbit/s, more than "
                             f"{BUS_SHARE:.0%} of a {self._bus_khz:g} kHz bus; use 400 kHz or a lower rate")

    def _retry(self, work: Callable[[], T]) -> T:
        return with_retries(work, self._sleep)

    def _read(self, register: int, count: int) -> bytes:
        return read_registers(self.bus, self._address, register, count)

    def _write(self, register: int, value: int) -> None:
        write_register(self.bus, self._address, register, value)
