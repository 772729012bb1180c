"""What the recorder makes of the leg controller's answers."""

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest

from daq.recording import ControllerIntake
from daq.recording.supervisor import Sample, Trip, may_ramp
from drivers import Capabilities, Pong


class Probed:
    """A controller that answers one probe, sent at 1 s and back 600 us later, with these ticks."""

    def __init__(self, rx_tick_us: int, tx_tick_us: int) -> None:
        self.capabilities = Capabilities()
        self.hello = SimpleNamespace(boot_id=1, telemetry_hz=500.0)
        self.answer = Pong(7, rx_tick_us, tx_tick_us)

    def ping(self) -> tuple[int, int]:
        return 7, 1_000_000_000

    def poll(self) -> list[Any]:
        return [SimpleNamespace(message=self.answer, host_ns=1_000_600_000)]


@pytest.mark.parametrize("ticks, bound_s", [((500, 600), 250e-6), ((2**32 - 50, 50), 250e-6), ((600, 500), math.inf)])
def test_an_answer_that_left_before_it_came_leaves_the_clock_unknown(ticks: tuple[int, int], bound_s: float) -> None:
    """A tick that stood still gave an uncertainty of -2147 s."""
    sink = SimpleNamespace(add=lambda *_, **__: None, event=lambda *_: None)
    intake = ControllerIntake(cast(Any, Probed(*ticks)), cast(Any, sink), cast(Any, None), lambda: 0)
    assert intake.clock_bound_s() is None
    intake.ping()
    intake.poll()
    assert intake.clock_bound_s() == pytest.approx(bound_s)
    assert may_ramp(Trip("clock_bound_s", "clock uncertainty in s", bound_s, 0.005), Sample()) is math.isfinite(bound_s)
