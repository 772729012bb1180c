"""A leg on virtual time whose controller's clock fails at a moment: ticks of telemetry, of probes, or of both."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq.recording import Plan
from drivers import Pong, Received, Telemetry
from tests.support.fault_bench import FaultBench

SECONDS = 8.0
MOMENTS_S = {"lead-in": -0.5, "start": 0.1, "driving": 3.0, "end": SECONDS - 0.6}
"""Of the plan."""
Fault = Callable[[float], float]
"""Seconds since the fault began -> by how much the ticks are off [s]."""
KINDS: dict[str, Fault] = {
    "back 25.57 s, as a counter at 168 MHz wraps": lambda t: -(2.0**32 / 168e6),
    "forward 1000 s": lambda t: 1000.0, "forward 0.5 s": lambda t: 0.5, "back 0.5 s": lambda t: -0.5,
    "forward 5 ms": lambda t: 5e-3, "back 5 ms": lambda t: -5e-3,
    "freeze for 50 ms, then on from there": lambda t: -min(t, 0.05),
    "freeze for 50 ms, then as before": lambda t: -t if t < 0.05 else 0.0,
    "freeze for good": lambda t: -t,
    "2 % faster": lambda t: 0.02 * t, "1 % slower": lambda t: -0.01 * t}
WHICH = ("both", "telemetry", "probes")
"""Ticks that are off."""


class ClockBench(FaultBench):
    """One recording."""

    def __init__(self, kind: str, which: str, moment: str) -> None:
        super().__init__(lambda bench: None, "never")
        times = np.arange(0.0, SECONDS, 0.01)
        self.plan = Plan(times, 0.25 * np.sin(2 * np.pi * 1.3 * times) + 0.1 * np.sin(2 * np.pi * 0.4 * times))
        self.clock_struck_ns = self.touched = 0
        self._offset, self._at_s = KINDS[kind], MOMENTS_S[moment]
        kinds = {"both": (Telemetry, Pong), "telemetry": (Telemetry,), "probes": (Pong,), "none": ()}
        self._altered_kinds = kinds[which]
        self._poll = self.controller.poll
        self.controller.poll = self._altered  # type: ignore[method-assign]
        self._began_ns = self.clock.now_ns()

    def _altered(self) -> list[Received]:
        return [one._replace(message=self._late(one.message)) if self._fails(one) else one  # type: ignore[arg-type]
                for one in self._poll()]

    def _fails(self, one: Received) -> bool:
        if self.clock.now_ns() - self._began_ns < (1.0 + self._at_s) * 1e9:  # after the lead-in
            return False
        self.clock_struck_ns = self.clock_struck_ns or self.clock.now_ns()
        return isinstance(one.message, self._altered_kinds)

    def _late(self, message: Telemetry | Pong) -> Telemetry | Pong:
        off_us = round(1e6 * self._offset((self.clock.now_ns() - self.clock_struck_ns) * 1e-9))
        self.touched += off_us != 0
        fields = ("tick_us",) if isinstance(message, Telemetry) else ("rx_tick_us", "tx_tick_us")
        return replace(message, **{name: (getattr(message, name) + off_us) % 2**32 for name in fields})


def strike(kind: str, which: str, moment: str, folder: Path) -> tuple[Path, str, int]:
    """The run of one recording, how it ended, and how many of its ticks were off."""
    bench = ClockBench(kind, which, moment)
    said = bench.run(folder).said
    return bench.path, said, bench.touched
