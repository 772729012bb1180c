"""`Supervisor`: says when a limit of rig.toml is passed, and names it. It decides; the recorder acts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from daq.rig import Limits


class Sample(NamedTuple):
    """The rig at one instant. None: not measured here, not checked. NaN: a reading that failed, trips."""

    torque_nm: float | None = None
    """Measured knee torque [N m]."""
    torque_cmd_nm: float | None = None
    """Torque about to be commanded [N m]."""
    q1_speed_radps: float | None = None
    q2_speed_radps: float | None = None
    q1_rad: float | None = None
    q2_rad: float | None = None
    temperature_degc: float | None = None
    controller_age_s: float | None = None
    """Time since the controller was last heard [s]."""
    imu_age_s: float | None = None
    """Time since the last IMU sample [s]."""
    clock_bound_s: float | None = None
    """How far the controller's clock may be off the host's [s]."""


class Trip(NamedTuple):
    """A quantity beside its limit."""

    limit: str
    """Key under `[limits]` in rig.toml."""
    what: str
    """What is limited, in words."""
    value: float
    bound: float

    def __str__(self) -> str:
        return f"limit {self.limit} tripped: {self.what} is {self.value:.4g}, allowed is {self.bound:.4g}"


WATCHED: tuple[tuple[str, str, str], ...] = (
    ("torque_nm", "torque_nm", "knee torque in N m"),
    ("torque_cmd_nm", "torque_nm", "commanded torque in N m"),
    ("q1_speed_radps", "speed_radps", "pivot speed in rad/s"),
    ("q2_speed_radps", "speed_radps", "knee speed in rad/s"),
    ("q1_rad", "q1_rad", "pivot angle in rad"),
    ("q2_rad", "q2_rad", "knee angle in rad"),
    ("temperature_degc", "temperature_degc", "motor temperature in degC"),
    ("controller_age_s", "staleness_s", "silence of the leg controller in s"),
    ("imu_age_s", "staleness_s", "silence of the IMU in s"),
    ("clock_bound_s", "clock_bound_s", "clock uncertainty in s"),
)
"""Field of `Sample`, key of `Limits`, and how a person calls it."""


class Supervisor:
    """Checks samples against limits. The first trip latches: every later check returns it again."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.trip: Trip | None = None

    def check(self, sample: Sample) -> Trip | None:
        """None while everything is within its limit, else the first limit passed."""
        if self.trip is None:
            self.trip = next(self._trips(sample), None)
        return self.trip

    def watched(self, sample: Sample) -> Iterator[Trip]:
        """Everything that is checked of this sample, passed or not."""
        for name, limit, what in WATCHED:
            value = getattr(sample, name)
            if value is not None:
                yield Trip(limit, what, value, getattr(self.limits, limit))

    def _trips(self, sample: Sample) -> Iterator[Trip]:
        for trip in self.watched(sample):
            # A temperature below zero is no danger; every other quantity counts by its size.
            size = trip.value if trip.limit == "temperature_degc" else abs(trip.value)
            if not size <= trip.bound:  # so written that NaN trips
                yield trip
