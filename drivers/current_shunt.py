"""INA226 and INA228 current monitors over I2C: the voltage across a shunt resistor, converted without a pause.

Registers and codes after TI SBOS547B (INA226) and SLYS021A (INA228), tables of section "Register Maps". Only the shunt
is converted; current is voltage over resistance, and the chips' own CURRENT register, which needs a calibration value
and overflows, is not used. Conversions are quicker than they are read: the newest one is read, and the flag "conversion
ready", which reading clears, says that there is a new one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from drivers.errors import DeviceAbsent, DeviceFault
from drivers.i2c_bus import I2CBus, claim, explain, read_registers, with_retries, write_registers

MANUFACTURER = 0x5449
AVERAGES = (1, 4, 16, 64, 128, 256, 512, 1024)
"""Averages by the code in the AVG field, of both chips."""
RESET_S = 0.001
CHECK_EVERY_S = 0.1
SHARE_OF_PERIOD = 0.6
"""A conversion takes at most this share of the time between readings, so that each brings a new one."""


@dataclass(frozen=True)
class Chip:
    """Properties in which the chips differ."""

    name: str
    die: tuple[int, int, int]
    """Register of the die's identity, its mask, its value."""
    manufacturer: int
    """Register of the manufacturer's identity."""
    reset: int
    """Value of register 0x00 that resets the chip."""
    voltage: int
    """Register of the shunt voltage."""
    voltage_bytes: int
    spare_bits: int
    """Unused bits at the low end of the voltage register."""
    volts_per_count: float
    flags: int
    """Register of the flags."""
    ready: int
    """Bit in it: a conversion has ended since it was last read."""
    overflow: int
    """Bit in it: the chip's arithmetic overflowed."""
    conversion_us: tuple[int, ...]
    """Conversion times by the code in the shunt's field."""
    mode: int
    """Shunt voltage alone, over and over."""

    def settings(self, conversion: int, averages: int) -> tuple[tuple[int, int], ...]:
        """(register, value) of codes for conversion time and averages."""
        if self.name == "INA226":
            return ((0x00, 0x4000 | averages << 9 | 0b100 << 6 | conversion << 3 | self.mode),)
        return ((0x00, 0x0000),  # range +-163.84 mV, no delay
                (0x01, self.mode << 12 | 0b101 << 9 | conversion << 6 | 0b101 << 3 | averages),
                (0x0B, 0x8000))  # the ready flag latches until it is read

    @property
    def rail(self) -> int:
        """Largest count; at it, or its negative, the shunt carries more than can be measured."""
        return int(2 ** (8 * self.voltage_bytes - self.spare_bits - 1) - 1)


CHIPS = {
    "ina226": Chip("INA226", (0xFF, 0xFFF0, 0x2260), 0xFE, 0x8000, 0x01, 2, 0, 2.5e-6, 0x06, 0x0008, 0x0004,
                   (140, 204, 332, 588, 1100, 2116, 4156, 8244), 0b101),
    "ina228": Chip("INA228", (0x3F, 0xFFF0, 0x2280), 0x3E, 0x8000, 0x04, 3, 4, 312.5e-9, 0x0B, 0x0002, 0x0200,
                   (50, 84, 150, 280, 540, 1052, 2074, 4120), 0b1010),
}


@dataclass(frozen=True)
class ShuntReading:
    """The mean current of one conversion."""

    raw: int
    """Counts of the shunt voltage."""
    flags: int
    """0, or bits `STALE` and `RAIL`."""
    t_before_ns: int
    """Host time around the transfer that brought it: the conversion ended at most its own length before."""
    t_after_ns: int

    @property
    def valid(self) -> bool:
        """New, and within the chip's range."""
        return not self.flags


STALE, RAIL = 1, 2
"""No conversion has ended since the reading before; the voltage is at the end of the chip's range."""


class CurrentShunt:
    """One chip on a bus. Not thread-safe: one thread reads it.

    Raises ValueError where no conversion of the chip is short enough for `rate_hz`.
    """

    def __init__(self, bus: I2CBus, kind: str, shunt_ohm: float, rate_hz: float, address: int = 0x40,
                 now_ns: Callable[[], int] = time.monotonic_ns, sleep: Callable[[float], None] = time.sleep) -> None:
        self.chip = CHIPS[kind]
        self.where = f"{self.chip.name} at 0x{address:02X}"
        self.amperes_per_count = self.chip.volts_per_count / shunt_ohm
        self._bus, self._address, self._now_ns, self._sleep = bus, address, now_ns, sleep
        codes = [(us * count * 1e-6, a, b) for a, us in enumerate(self.chip.conversion_us)
                 for b, count in enumerate(AVERAGES) if us * count * 1e-6 * rate_hz <= SHARE_OF_PERIOD]
        if not codes:
            fastest = SHARE_OF_PERIOD * 1e6 / min(self.chip.conversion_us)
            raise ValueError(f"an {self.chip.name} cannot be read {rate_hz:g} times a second; at most {fastest:.0f}")
        self.conversion_s, conversion, averages = max(codes)
        """Time over which one reading is the mean."""
        self._settings = self.chip.settings(conversion, averages)
        self._check_due_ns = 0
        self._ready = False

    @property
    def range_a(self) -> float:
        """Largest current that the chip can measure [A]."""
        return self.chip.rail * self.amperes_per_count

    def open(self) -> None:
        """Identify, reset, configure, read back, and wait for a first conversion.

        Raises `DeviceAbsent`, `DeviceBusy` or `DeviceFault`.
        """
        try:
            claim(self._bus, self._address)
            with_retries(self._identify, self._sleep)
            with_retries(self._configure, self._sleep)
        except OSError as error:
            raise explain(error, self.where) from error
        self._sleep(2.0 * self.conversion_s)
        if self.read().flags & STALE:
            raise DeviceFault(f"{self.where}: configured, but converts nothing; power-cycle the chip")
        self._ready = True  # nobody has had this one yet

    def read(self) -> ShuntReading:
        """The newest conversion. A transfer that fails is tried three times more.

        Raises `DeviceAbsent` or `DeviceBusy` where the chip stays silent, `DeviceFault` where it lost its settings.
        """
        try:
            if self._now_ns() >= self._check_due_ns:
                self._check_due_ns = self._now_ns() + round(CHECK_EVERY_S * 1e9)
                with_retries(self._verify, self._sleep)
            return with_retries(self._read_once, self._sleep)
        except OSError as error:
            raise explain(error, self.where) from error

    def close(self) -> None:
        """Let go of the bus."""
        self._bus.close()

    def _identify(self) -> None:
        register, mask, value = self.chip.die
        maker, die = self._word(self.chip.manufacturer), self._word(register)
        if maker != MANUFACTURER or die & mask != value:
            raise DeviceAbsent(f"{self.where}: identifies itself as 0x{maker:04X} 0x{die:04X}, an {self.chip.name} has "
                               f"0x{MANUFACTURER:04X} 0x{value:04X}; correct [devices.shunt] kind or address")

    def _configure(self) -> None:
        write_registers(self._bus, self._address, 0x00, self.chip.reset.to_bytes(2, "big"))
        self._sleep(RESET_S)
        for register, value in self._settings:
            write_registers(self._bus, self._address, register, value.to_bytes(2, "big"))
        self._verify()

    def _verify(self) -> None:
        for register, value in self._settings:
            if register == self.chip.flags:
                continue  # reading it would clear the ready flag
            found = self._word(register)
            if found != value:
                raise DeviceFault(f"{self.where}: register 0x{register:02X} reads 0x{found:04X} after 0x{value:04X} "
                                  "was written; check supply and bus clock")

    def _read_once(self) -> ShuntReading:
        flags = self._word(self.chip.flags)
        self._ready |= bool(flags & self.chip.ready)  # kept where the transfer that follows fails: reading cleared it
        before_ns = self._now_ns()
        data = read_registers(self._bus, self._address, self.chip.voltage, self.chip.voltage_bytes)
        after_ns = self._now_ns()
        raw = int.from_bytes(data, "big", signed=True) >> self.chip.spare_bits
        railed = abs(raw) >= self.chip.rail or bool(flags & self.chip.overflow)
        stale, self._ready = not self._ready, False
        return ShuntReading(raw, STALE * stale | RAIL * railed, before_ns, after_ns)

    def _word(self, register: int) -> int:
        return int.from_bytes(read_registers(self._bus, self._address, register, 2), "big")
