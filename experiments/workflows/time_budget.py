"""The wall time of an investigation: what was spent, what a step is expected to take, and an end that is kept."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from experiments.judge import Ending

OVERHEAD_S = 5.0
"""Of a recording: devices opened, clocks probed, file closed."""
FIRST_DIAGNOSIS, FIRST_DESIGN_S, RESERVE = 4.0, 20.0, 1.3
"""Expected time of the first diagnosis per second of motion, expected time [s] of a design, and what a step may take
longer than the one before."""


class Spent(KeyboardInterrupt):
    """The budget is spent: ends a computation as Ctrl-C does."""


class End(Exception):
    """The investigation ends."""

    def __init__(self, ending: Ending, why: str) -> None:
        super().__init__(why)
        self.ending, self.why = ending, why


@dataclass
class Clock:
    """Wall time of an investigation, and how long its parts take."""

    budget_s: float
    started: float = field(default_factory=time.monotonic)
    recording: float = 1.0
    """Seconds a second of plan."""
    diagnosis: float = FIRST_DIAGNOSIS
    """Seconds a second of motion."""
    design_s: float = FIRST_DESIGN_S

    @property
    def spent_s(self) -> float:
        return time.monotonic() - self.started

    def expected_s(self, plans_s: float, runs: int, motion_s: float, design: bool) -> float:
        """Expected time [s] to record `runs` plans of `plans_s` together, and to diagnose `motion_s` with them."""
        return (self.recording * plans_s + OVERHEAD_S * runs + RESERVE * self.diagnosis * (motion_s + plans_s)
                + (self.design_s if design else 0.0))

    def require(self, needed_s: float, what: str) -> None:
        """Ends the investigation where `what` is not expected to end in time."""
        left = self.budget_s - self.spent_s
        if needed_s > left:
            raise End("budget", f"The budget of {self.budget_s / 60.0:g} min has {max(left, 0.0) / 60.0:.1f} min left, "
                                 f"and {what} is expected to take {needed_s / 60.0:.1f} min.")

    @contextmanager
    def limited(self) -> Iterator[None]:
        """Within it a computation ends when the budget does (in the main thread; elsewhere between its stages)."""
        left = self.budget_s - self.spent_s
        if left <= 0.0:
            raise Spent
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def end(number: int, frame: object) -> None:
            raise Spent

        before = signal.signal(signal.SIGALRM, end)
        signal.setitimer(signal.ITIMER_REAL, left)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)
