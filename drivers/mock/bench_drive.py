"""Common parts of every emulated drive: the far end of its cable, its motor, its sensors, its warmth.

`BenchDrive` knows no protocol. A drive's emulator gives the frames; `MockRig` steps it with the leg's physics.
"""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.drive import Wiring
from drivers.mock.motor import Motor
from drivers.mock.plant import Segment, Snapshot
from drivers.mock.settings import FirmwareSettings

TURNAROUND_NS = 60_000
"""Time from the last bit of a request to the first of its answer."""
COUNTS = 16_384
"""Counts of the drive's encoder, a turn of its own."""


class DriveFacts(NamedTuple):
    """Default address and identity of an emulated drive."""

    node: int
    rate_hz: float
    """Rate at which it is polled [Hz]."""
    serial: bool
    """It is served on a serial port, itself or behind its adapter; otherwise on CAN."""


class BenchDrive(ABC):
    """One emulated drive. `advance(t_ns)` brings the world up to a time before anything is answered."""

    nothing: Any = ()
    """An empty chunk."""

    def __init__(self, settings: FirmwareSettings, wiring: Wiring, seed: int = 0, t_ns: int = 0,
                 advance: Callable[[int], None] = lambda t_ns: None, lock: threading.RLock | None = None) -> None:
        self.settings, self.wiring = settings, wiring
        self.motor = Motor(settings.current_loop_s)
        self.torque_nm = 0.0
        """Asked of the motor now, at the drive [N m]."""
        self.encoder_ok = True
        self.alive = True
        """Set to False: its processor hangs. It answers nothing, and its power stage goes on as it is."""
        self.powered = True
        self.bus_v, self.degc = settings.bus_v, settings.ambient_degc
        self.stage_gain = 1.0
        """What the power stage makes of a torque: 0 where it is dead, -1 where it is reversed."""
        self._rng = np.random.default_rng(seed)
        self._advance, self._lock = advance, lock or threading.RLock()
        self._inbox: deque[tuple[int, Any]] = deque()
        self._outbox: deque[tuple[int, Any]] = deque()
        self._now_ns = self._t_ns = self._boot_ns = self._warmed_ns = t_ns
        still = Snapshot()
        self._segment = Segment(t_ns - 1, t_ns, still, still)
        self._set_up()

    @abstractmethod
    def _set_up(self) -> None:
        """Its own state after power-on."""

    @abstractmethod
    def _obey(self, data: Any, t_ns: int) -> None:
        """A chunk has come."""

    @abstractmethod
    def _check(self, t_ns: int) -> None:
        """What is due by the clock or by a limit: watchdog, faults, frames that come unasked."""

    # -- chunks --------------------------------------------------------------------------------------------

    def receive(self, data: Any, t_ns: int) -> None:
        """A chunk that is there now."""
        with self._lock:
            self._advance(t_ns)
            if self.alive and self.powered:
                self._now_ns = t_ns
                self._obey(data, t_ns)

    def post(self, data: Any, t_ns: int) -> None:
        """A chunk under way that will be there at `t_ns`."""
        with self._lock:
            self._inbox.append((t_ns, data))

    def transmit(self, until_ns: int) -> list[tuple[int, Any]]:
        """(time, chunk) of what left the drive up to `until_ns`, in order, each once."""
        with self._lock:
            self._advance(until_ns)
            self._take_in(until_ns)
            out = []
            while self._outbox and self._outbox[0][0] <= until_ns:
                out.append(self._outbox.popleft())
        return out

    def _take_in(self, until_ns: int) -> None:
        while self._inbox and self._inbox[0][0] <= until_ns:
            t_ns, data = self._inbox.popleft()
            if self.alive and self.powered:
                self._now_ns = t_ns
                self._obey(data, t_ns)

    def _send(self, data: Any, t_ns: int) -> None:
        self._outbox.append((t_ns + TURNAROUND_NS, data))

    # -- physics -------------------------------------------------------------------------------------------

    def torque_over(self, t0_ns: int, t1_ns: int) -> float:
        """Mean joint torque [N m] in the physics step that follows."""
        self._take_in(t0_ns)
        self._t_ns = t0_ns
        if self.alive and self.powered:
            self._now_ns = t0_ns
            self._check(t0_ns)
        asked = self.torque_nm * self.wiring.turns if self.powered else 0.0
        return self.settings.torque_gain * self.stage_gain * self.motor.step(t0_ns, (t1_ns - t0_ns) * 1e-9, asked)

    def observe(self, segment: Segment) -> None:
        """Update the sensors after a step; the motor warms up."""
        self._segment = segment
        s, span_s = self.settings, (segment.t1_ns - self._warmed_ns) * 1e-9
        if span_s >= 0.01:
            current = self.motor.last_mean_nm / s.torque_constant_nm_per_a
            final = s.ambient_degc + s.heating_degc_per_a2 * current**2
            self.degc += (final - self.degc) * span_s / s.heating_time_s
            self._warmed_ns = segment.t1_ns

    @property
    def record(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """(t_ns, torque commanded, torque acting) of every physics step, at the joint [N m]."""
        return self.motor.record

    # -- sensors, in the drive's units ---------------------------------------------------------------------

    @property
    def _state(self) -> Snapshot:
        """The leg when the request came. The physics runs in whole steps, mostly past that time."""
        segment = self._segment
        return segment.at(max(segment.t0_ns, min(segment.t1_ns, self._now_ns)))

    @property
    def turns(self) -> float:
        """Angle by its encoder [turns of its own]; NaN where that is lost."""
        if not self.encoder_ok:
            return math.nan
        true = (self._state.q2_motor + self.settings.knee_zero_rad) * self.wiring.turns / (2.0 * math.pi)
        return math.floor(true * COUNTS + 0.5) / COUNTS

    @property
    def turns_per_s(self) -> float:
        """Speed [turns/s]."""
        return self._state.q2d * self.wiring.turns / (2.0 * math.pi)

    @property
    def current_a(self) -> float:
        """Measured motor current [A], in the drive's direction."""
        s = self.settings
        joint = self.stage_gain * self.motor.torque_at(self._now_ns) / s.torque_constant_nm_per_a + s.shunt_offset_a
        return (joint + s.current_noise_a * float(self._rng.standard_normal())) * math.copysign(1.0, self.wiring.turns)

    @property
    def volts(self) -> float:
        """Supply under load [V]."""
        return self.bus_v - self.settings.bus_resistance_ohm * abs(self.motor.last_mean_nm
                                                                  / self.settings.torque_constant_nm_per_a)

    def power_cycle(self) -> None:
        """Off and on again: what it knew is gone."""
        self.torque_nm, self.alive = 0.0, True
        self._boot_ns = self._t_ns
        self._inbox.clear()
        self._outbox.clear()
