"""Clocks for emulated devices: the machine's own, and one that moves only when somebody waits."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Host time and waiting."""

    def now_ns(self) -> int:
        """Host time [ns]."""

    def sleep(self, seconds: float) -> None:
        """Wait [s]."""


class RealClock:
    """The machine's monotonic clock."""

    def now_ns(self) -> int:
        """Host time [ns]."""
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        """Wait [s]."""
        time.sleep(seconds)


class VirtualClock:
    """Time that costs nothing: waiting moves it at once, everything else leaves it where it is."""

    def __init__(self, start_ns: int = 1_000_000_000) -> None:
        self._now_ns = start_ns
        self._lock = threading.Lock()

    def now_ns(self) -> int:
        """Virtual time [ns]."""
        return self._now_ns

    def sleep(self, seconds: float) -> None:
        """Move on by `seconds`; at least by a nanosecond, so that a polling loop ends."""
        self.advance(max(1, round(seconds * 1e9)))

    def advance(self, ns: int) -> None:
        """Move on by `ns`, never back."""
        if ns < 0:
            raise ValueError("time does not run backwards")
        with self._lock:
            self._now_ns += ns

    def advance_to(self, t_ns: int) -> None:
        """Move on to `t_ns`; a time already past changes nothing."""
        with self._lock:
            self._now_ns = max(self._now_ns, t_ns)
