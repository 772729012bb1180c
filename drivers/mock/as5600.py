"""A register-level AS5600 over a magnet that turns with the pivot (ams DS000365 1-06, figures 21 to 23)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from drivers import as5600 as chip
from drivers.mock.chip import MockChip
from drivers.mock.clock import Clock
from drivers.mock.settings import PivotSettings

WRITABLE = 0x3F
"""Bits of CONF's high byte that exist."""
POINTER_STAYS = (chip.RAW_ANGLE, 0x0E, chip.AGC + 1)
"""High bytes at which the address pointer stays for two bytes and goes back (section "Automatic Increment")."""
WEAK_AGC, STRONG_AGC, USUAL_AGC = 128, 0, 64


class MockAs5600(MockChip):
    """`angle(t_ns)` gives the pivot's angle [rad]; `status` is the magnet's state: without MD there is none."""

    def __init__(self, clock: Clock, angle: Callable[[int], float] = lambda t_ns: 0.0,
                 settings: PivotSettings | None = None, seed: int = 0, **wire: Any) -> None:
        super().__init__(clock, chip.ADDRESS, **wire)
        self.status = chip.MD
        self.stuck = False
        """The angle stays where it is."""
        self._angle, self._settings = angle, settings or PivotSettings()
        self._rng = np.random.default_rng(seed)
        self._last = 0
        self._registers = bytearray(256)

    def brown_out(self) -> None:
        """Supply dips: what was not burnt in is gone."""
        self._registers = bytearray(256)

    def receive(self, register: int, data: bytes) -> None:
        for at, value in enumerate(data, register):
            if 0x01 <= at <= chip.CONF_L:
                self._registers[at & 0xFF] = value & WRITABLE if at == chip.CONF_H else value

    def read(self, register: int, count: int) -> bytes:
        if register in POINTER_STAYS:
            word = self._word(register)
            return (word * (count // 2 + 1))[:count]
        found = bytearray()
        for at in range(register, register + count):
            found.append(self._byte(at & 0xFF))
        self._pointer = register + count & 0xFF
        return bytes(found)

    def _byte(self, register: int) -> int:
        if register == chip.STATUS:
            return self.status
        if register == chip.AGC:
            return WEAK_AGC if self.status & chip.ML else STRONG_AGC if self.status & chip.MH else USUAL_AGC
        for high in POINTER_STAYS:
            if register in (high, high + 1):
                return self._word(high)[register - high]
        return self._registers[register]

    def _word(self, high: int) -> bytes:
        if high == chip.AGC + 1:
            return (2000).to_bytes(2, "big")
        return self._counts().to_bytes(2, "big")

    def _counts(self) -> int:
        s = self._settings
        if not self.stuck:
            seen_ns = self._clock.now_ns() - round(0.5e9 * chip.SETTLING_S)
            angle = s.sign * self._angle(seen_ns) + s.zero_rad + s.noise_rad * self._rng.standard_normal()
            angle += s.eccentricity_rad * math.sin(angle)
            self._last = math.floor(angle / chip.RADIANS_PER_COUNT + 0.5) % chip.COUNTS
        return self._last if self.status & chip.MD else 0
