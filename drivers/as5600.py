"""AS5600 magnetic angle sensor over I2C: the passive joint's angle, 4096 counts a turn, and how well its magnet sits.

Registers and codes after ams datasheet DS000365, revision 1-06 (2018-Jun-20): register map figure 21, CONF figure 22,
STATUS figure 23. RAW ANGLE is read, not ANGLE, which has a hysteresis of 10 counts at the end of its range. Nothing
is ever burnt into the chip: it has three burns in its life.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from drivers.errors import DeviceAbsent, DeviceFault
from drivers.i2c_bus import BACKOFF_S, I2CBus, claim, explain, read_registers, with_retries, write_register

ADDRESS = 0x36
"""The only one it has."""
ZMCO, CONF_H, CONF_L, STATUS, RAW_ANGLE, AGC = 0x00, 0x07, 0x08, 0x0B, 0x0C, 0x1A
MD, ML, MH = 0x20, 0x10, 0x08
"""Bits of STATUS: magnet detected; too weak (gain at its most), too strong (gain at its least)."""
COUNTS = 4096
RADIANS_PER_COUNT = 2.0 * math.pi / COUNTS
CONF = 0x0300
"""Power mode normal, no hysteresis, slow filter 2x (the quickest), no fast filter, watchdog off."""
CONF_MASK = 0x3FFF
SETTLING_S = 0.286e-3
"""Settling time of the slow filter at 2x: an angle is late by less than this (datasheet, figure 33)."""
AGC_EVERY_S = 0.1
BYTES = 9
"""On the wire for one reading: two transfers of address, register, address, and three bytes of data."""


@dataclass(frozen=True)
class PivotReading:
    """One reading of the chip."""

    raw: int
    """Counts, 0 to 4095."""
    status: int
    """STATUS, after the angle was read: a magnet that was lost meanwhile shows."""
    agc: int
    """Gain of the chip's amplifier: 0 to 255 at 5 V, 0 to 128 at 3.3 V; read ten times a second."""
    magnitude: int
    """Size of the field, of the chip's own unit; read with `agc`."""
    t_before_ns: int
    """Host time around the transfer that brought the angle."""
    t_after_ns: int

    @property
    def valid(self) -> bool:
        """A magnet was there; without one the chip's angle means nothing. Too weak and too strong at once: bus lines
        that are not driven."""
        return self.status & (MD | ML | MH) in (MD, MD | ML, MD | MH)


class As5600:
    """One chip on a bus. Not thread-safe: one thread reads it."""

    def __init__(self, bus: I2CBus, address: int = ADDRESS, now_ns: Callable[[], int] = time.monotonic_ns,
                 sleep: Callable[[float], None] = time.sleep) -> None:
        self.where = f"AS5600 at 0x{address:02X}"
        self._bus, self._address, self._now_ns, self._sleep = bus, address, now_ns, sleep
        self._gain = (0, 0)
        self._gain_due_ns = self._conf_due_ns = 0

    def open(self) -> PivotReading:
        """Configure, read back, and look for the magnet; returns a first reading.

        Raises `DeviceAbsent`, `DeviceBusy`, or `DeviceFault` where it is another chip or has no magnet.
        """
        try:
            claim(self._bus, self._address)
            with_retries(self._configure, self._sleep)
        except OSError as error:
            raise explain(error, self.where) from error
        self._sleep(BACKOFF_S)
        first = self.read()
        problem = magnet_problem(first.status)
        if not first.valid:
            raise DeviceFault(f"{self.where}: {problem}")
        return first

    def read(self) -> PivotReading:
        """The angle now, with the magnet's state. A transfer that fails is tried three times more.

        Raises `DeviceAbsent` or `DeviceBusy` where the chip stays silent, `DeviceFault` where it lost its settings.
        """
        try:
            if self._now_ns() >= self._conf_due_ns:
                self._conf_due_ns = self._now_ns() + round(AGC_EVERY_S * 1e9)
                with_retries(self._verify, self._sleep)
            return with_retries(self._read, self._sleep)
        except OSError as error:
            raise explain(error, self.where) from error

    def close(self) -> None:
        """Let go of the bus."""
        self._bus.close()

    def _configure(self) -> None:
        burns = read_registers(self._bus, self._address, ZMCO, 1)[0]
        if burns & ~0x03:
            raise DeviceAbsent(f"{self.where}: register 0x00 reads 0x{burns:02X}, an AS5600 has at most 0x03 there; "
                               "another chip is wired there, correct [devices.pivot] address")
        write_register(self._bus, self._address, CONF_H, CONF >> 8)
        write_register(self._bus, self._address, CONF_L, CONF & 0xFF)
        self._verify()

    def _verify(self) -> None:
        found = int.from_bytes(read_registers(self._bus, self._address, CONF_H, 2), "big") & CONF_MASK
        if found != CONF:
            raise DeviceFault(f"{self.where}: register CONF reads 0x{found:04X} after 0x{CONF:04X} was written; check "
                              "supply and bus clock")

    def _read(self) -> PivotReading:
        before_ns = self._now_ns()
        angle = read_registers(self._bus, self._address, RAW_ANGLE, 2)
        after_ns = self._now_ns()
        status = read_registers(self._bus, self._address, STATUS, 1)[0]
        if after_ns >= self._gain_due_ns:
            self._gain_due_ns = after_ns + round(AGC_EVERY_S * 1e9)
            gain = read_registers(self._bus, self._address, AGC, 1)[0]
            size = int.from_bytes(read_registers(self._bus, self._address, AGC + 1, 2), "big") & 0x0FFF
            self._gain = gain, size
        raw = int.from_bytes(angle, "big") & (COUNTS - 1)
        return PivotReading(raw, status, *self._gain, before_ns, after_ns)


def magnet_problem(status: int) -> str:
    """Fault of the magnet by the register STATUS, with the remedy; empty without a fault."""
    if status & ML and status & MH:
        return "the status cannot be true; check wiring and pull-ups"
    if not status & MD:
        return "no magnet: the field is too weak to give an angle; put the magnet 0.5 to 3 mm above the chip's centre"
    if status & ML:
        return "the magnet is too weak: the gain is at its most; bring it nearer to the chip"
    if status & MH:
        return "the magnet is too strong: the gain is at its least; move it away from the chip"
    return ""
