"""Physics of a leg that does not move, for tests of emulated devices."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class StillState:
    """A leg that does not move."""

    q1: float = 0.0
    q2: float = 0.0
    q1d: float = 0.0
    q2d: float = 0.0
    q1dd: float = 0.0


@dataclass
class StillPlant:
    """A leg held fast in one place."""

    state: StillState = StillState()

    def step(self, dt_s: float, torque_nm: float) -> StillState:
        """Return the same state at all times."""
        return self.state


@dataclass
class MovingPlant:
    """A leg whose motion is prescribed: its state at a time [s]."""

    state: Callable[[float], Any]
    t: float = 0.0

    def step(self, dt_s: float, torque_nm: float) -> Any:
        """Return the state at the next time."""
        self.t += dt_s
        return self.state(self.t)
