"""Intake of sensors that stand alone on an I2C bus: the pivot's AS5600, a second current shunt. Each is asked in turn.

Such a sensor has no clock: a sample's time lies between the request and the reply, and both are recorded.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from daq.recording.intake import FRESH, Sink
from daq.recording.workers import Workers
from daq.rig import Rig
from daq.si_units import pivot_angle
from drivers import As5600, CurrentShunt, PivotReading, ShuntReading


@dataclass(frozen=True)
class Sensors:
    """Open sensors of a rig besides IMU and controller."""

    pivot: As5600 | None = None
    shunt: CurrentShunt | None = None


class PivotIntake:
    """Readings of the AS5600. `poll` belongs to one thread."""

    def __init__(self, sensor: As5600 | None, sink: Sink, rig: Rig, now_ns: Callable[[], int]) -> None:
        self.rad: float | None = None
        """Newest angle of the pivot [rad], not wrapped; NaN: no magnet; None before any."""
        self.heard_ns = now_ns()
        """Host time of the last valid reading."""
        self.fresh: deque[tuple[int, float]] = deque(maxlen=FRESH)
        """Host time [ns] and angle [rad] of valid readings that nobody has looked through yet, oldest first."""
        self._sensor, self._sink, self._rig = sensor, sink, rig
        self._near = 0.0

    def poll(self) -> None:
        """One reading, stamped and written. Raises `DriverError` when the chip has gone."""
        assert self._sensor is not None
        self.take(self._sensor.read())

    def take(self, reading: PivotReading) -> None:
        """A reading that came, or is played back."""
        self._sink.add("/pivot", reading.t_before_ns, reading.t_before_ns, reading.t_after_ns, reading.raw,
                       reading.magnitude, reading.status, reading.agc)
        if not reading.valid:
            self.rad = math.nan
            return
        self._near = self.rad = pivot_angle(reading.raw, self._rig, self._near)
        self.heard_ns = reading.t_after_ns
        self.fresh.append((reading.t_after_ns, self.rad))


class ShuntIntake:
    """Readings of the current shunt. `poll` belongs to one thread."""

    def __init__(self, sensor: CurrentShunt | None, sink: Sink, now_ns: Callable[[], int]) -> None:
        self.heard_ns = now_ns()
        """Host time of the last valid reading."""
        self._sensor, self._sink = sensor, sink

    def poll(self) -> None:
        """One reading, stamped and written. Raises `DriverError` when the chip has gone."""
        assert self._sensor is not None
        self.take(self._sensor.read())

    def take(self, reading: ShuntReading) -> None:
        """A reading that came, or is played back."""
        self._sink.add("/shunt", reading.t_before_ns, reading.t_before_ns, reading.t_after_ns, reading.raw,
                       reading.flags)
        if reading.valid:
            self.heard_ns = reading.t_after_ns


class SensorIntakes:
    """All of them; with `sensors` empty there is nothing to do."""

    def __init__(self, sensors: Sensors, sink: Sink, rig: Rig, now_ns: Callable[[], int]) -> None:
        self.pivot = PivotIntake(sensors.pivot, sink, rig, now_ns) if sensors.pivot else None
        self.shunt = ShuntIntake(sensors.shunt, sink, now_ns) if sensors.shunt else None
        devices = rig.devices
        self._polls: list[tuple[str, Callable[[], None], float]] = []
        if self.pivot is not None:
            self._polls.append(("pivot", self.pivot.poll, 1.0 / devices.pivot.rate_hz if devices.pivot else 0.005))
        if self.shunt is not None:
            self._polls.append(("shunt", self.shunt.poll, 1.0 / devices.shunt.rate_hz if devices.shunt else 0.005))
        self._due_ns = dict.fromkeys((name for name, _, _ in self._polls), 0)

    def start(self, workers: Workers) -> None:
        """A thread for each."""
        for name, poll, every_s in self._polls:
            workers.start(name, poll, every_s)

    def turn(self, now_ns: int) -> None:
        """Whatever is due by now, where there are no threads."""
        for name, poll, every_s in self._polls:
            if now_ns >= self._due_ns[name]:
                self._due_ns[name] = now_ns + round(every_s * 1e9)
                poll()
