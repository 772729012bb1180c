"""A register-level INA226 or INA228 with a shunt resistor in the motor's lead (TI SBOS547B, SLYS021A)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from drivers.current_shunt import AVERAGES, CHIPS, MANUFACTURER
from drivers.mock.chip import MockChip
from drivers.mock.clock import Clock
from drivers.mock.settings import ShuntSettings

DEFAULTS = {"ina226": {0x00: 0x4127}, "ina228": {0x01: 0xFB68, 0x02: 0x1000, 0x0B: 0x0001}}
REVISION = {"ina226": 0x0, "ina228": 0x1}
READ_ONLY = {"ina226": {0x01, 0x02, 0x03, 0x04, 0xFE, 0xFF}, "ina228": {*range(0x04, 0x0B), 0x3E, 0x3F}}
WIDE = {"ina226": dict[int, int](), "ina228": {0x04: 3, 0x05: 3, 0x07: 3, 0x08: 3, 0x09: 5, 0x0A: 5}}
"""Registers of more than two bytes."""


class MockShunt(MockChip):
    """`charge(t_ns)` gives the integral of the current [A s]; a conversion is its mean over the time set."""

    def __init__(self, clock: Clock, charge: Callable[[int], float] = lambda t_ns: 0.0, kind: str = "ina226",
                 settings: ShuntSettings | None = None, seed: int = 0, address: int = 0x40, **wire: Any) -> None:
        super().__init__(clock, address, **wire)
        self.converting = True
        """False: it has stopped."""
        self._kind, self._chip, self._charge = kind, CHIPS[kind], charge
        self._settings = settings or ShuntSettings()
        self._rng = np.random.default_rng(seed)
        self.brown_out()

    def brown_out(self) -> None:
        """Supply dips: registers return to their defaults, as after power-up."""
        self._registers = dict(DEFAULTS[self._kind])
        self._restart()

    def receive(self, register: int, data: bytes) -> None:
        if len(data) != 2 or register in READ_ONLY[self._kind]:
            return
        value = int.from_bytes(data, "big")
        if register == 0x00 and value & self._chip.reset:
            self.brown_out()
            return
        self._registers[register] = value
        if register in (0x00, 0x01):
            self._restart()

    def read(self, register: int, count: int) -> bytes:
        wide = WIDE[self._kind].get(register, 2)
        self._convert()
        value = self._value(register)
        return (value.to_bytes(wide, "big", signed=value < 0) * (count // wide + 1))[:count]

    # -- the chip ------------------------------------------------------------------------------------------

    def _restart(self) -> None:
        self._started_ns, self._done, self._seen, self._raw = self._clock.now_ns(), 0, 0, 0

    @property
    def _period_ns(self) -> int:
        """Time of one conversion with its averages [ns]; 0: the shunt is not converted."""
        if self._kind == "ina226":
            word = self._registers.get(0x00, 0)
            on, code, averages = word & 0b101 == 0b101, word >> 3 & 7, word >> 9 & 7
        else:
            word = self._registers.get(0x01, 0)
            on, code, averages = word >> 12 & 0b1010 == 0b1010, word >> 6 & 7, word & 7
        slow = 1.0 + self._settings.clock_error
        return round(self._chip.conversion_us[code] * AVERAGES[averages] * 1e3 * slow) if on else 0

    def _convert(self) -> None:
        """The newest conversion that has ended by now."""
        period_ns = self._period_ns
        if not period_ns or not self.converting:
            return
        count = (self._clock.now_ns() - self._started_ns) // period_ns
        if count == self._done:
            return
        self._done = count
        s, end_ns = self._settings, self._started_ns + count * period_ns
        mean = (self._charge(end_ns) - self._charge(end_ns - period_ns)) / (period_ns * 1e-9)
        volts = s.shunt_ohm * s.sign * mean + s.offset_v + s.noise_v * self._rng.standard_normal()
        counts = round(volts / self._chip.volts_per_count)
        self._raw = max(-self._chip.rail - 1, min(self._chip.rail, counts))

    def _value(self, register: int) -> int:
        if register == self._chip.voltage:
            return self._raw << self._chip.spare_bits
        if register == self._chip.manufacturer:
            return MANUFACTURER
        if register == self._chip.die[0]:
            return self._chip.die[2] | REVISION[self._kind]
        value = self._registers.get(register, 0)
        if register == self._chip.flags:
            fresh, self._seen = self._done != self._seen, self._done
            value = value & ~self._chip.ready | self._chip.ready * fresh
        return value
