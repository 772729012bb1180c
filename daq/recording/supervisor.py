"""`Supervisor`: says when a limit of rig.toml is passed, and names it. It decides; the recorder acts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from daq.rig_limits import Limits


class Sample(NamedTuple):
    """The rig at one instant. None: not measured here, not checked. NaN: a reading that failed, trips."""

    torque_nm: float | None = None
    """Measured knee torque [N m]."""
    torque_cmd_nm: float | None = None
    """Torque about to be commanded [N m]."""
    q1_speed_radps: float | None = None
    gyro_radps: float | None = None
    """The same; the gyro has a limit of its own."""
    q2_speed_radps: float | None = None
    q1_rad: float | None = None
    q2_rad: float | None = None
    q1_ahead_rad: float | None = None
    """Angle at which the joint comes to rest if the torque is cut now [rad]."""
    q2_ahead_rad: float | None = None
    temperature_degc: float | None = None
    bus_v: float | None = None
    controller_age_s: float | None = None
    """Age of what the controller said of the leg [s]."""
    imu_age_s: float | None = None
    """Time since the last IMU sample [s]."""
    pivot_age_s: float | None = None
    """Time since the pivot sensor's last valid reading [s]."""
    shunt_age_s: float | None = None
    """Time since the second shunt's last valid reading [s]."""
    clock_bound_s: float | None = None
    """How far the controller's clock may be off the host's [s]."""
    unsaved_s: float | None = None
    """Age of the oldest message that is not on the disk [s]."""
    echo_s: float | None = None
    """How long this check of `plausibility` has failed [s], and so on."""
    torque_s: float | None = None
    encoder_s: float | None = None
    imu_stuck_s: float | None = None
    imu_rail_s: float | None = None
    pivot_s: float | None = None


class Trip(NamedTuple):
    """A quantity and its limit."""

    limit: str
    """Key under `[limits]` in rig.toml."""
    what: str
    """What is limited, in words."""
    value: float
    bound: float

    def __str__(self) -> str:
        if math.isnan(self.value):
            return f"limit {self.limit} tripped: {self.what} cannot be checked, its sensor gives no valid reading"
        return f"limit {self.limit} tripped: {self.what} is {self.value:.4g}, allowed is {self.bound:.4g}"


WATCHED: tuple[tuple[str, str, str], ...] = (
    ("torque_nm", "torque_nm", "knee torque in N m"),
    ("torque_cmd_nm", "torque_nm", "commanded torque in N m"),
    ("q1_speed_radps", "speed_radps", "pivot speed in rad/s"),
    ("gyro_radps", "q1_speed_radps", "pivot speed by the gyro in rad/s"),
    ("q2_speed_radps", "speed_radps", "knee speed in rad/s"),
    ("q1_rad", "q1_rad", "pivot angle in rad"),
    ("q2_rad", "q2_rad", "knee angle in rad"),
    ("q1_ahead_rad", "q1_rad", "pivot angle after stopping in rad"),
    ("q2_ahead_rad", "q2_rad", "knee angle after stopping in rad"),
    ("temperature_degc", "temperature_degc", "motor temperature in degC"),
    ("bus_v", "bus_v", "supply voltage in V"),
    ("controller_age_s", "staleness_s", "silence of the leg controller in s"),
    ("imu_age_s", "staleness_s", "silence of the IMU in s"),
    ("pivot_age_s", "staleness_s", "time in s without a valid angle of the pivot sensor"),
    ("shunt_age_s", "staleness_s", "time in s without a valid current of the second shunt"),
    ("clock_bound_s", "clock_bound_s", "clock uncertainty in s"),
    ("unsaved_s", "unsaved_s", "age of what is not on the disk in s"),
    ("echo_s", "echo_s", "time in s for which the drive echoes another torque than commanded"),
    ("torque_s", "torque_s", "time in s for which commanded and measured torque disagree"),
    ("encoder_s", "encoder_s", "time in s for which knee encoder and knee Hall angle disagree"),
    ("imu_stuck_s", "imu_stuck_s", "time in s for which the IMU repeats one reading"),
    ("imu_rail_s", "imu_rail_s", "time in s for which the IMU is at its rail"),
    ("pivot_s", "pivot_s", "time in s for which gyro and pivot Hall angle disagree"),
)
"""Field of `Sample`, key of `Limits`, and how a person calls it."""


TRUSTED = frozenset({"temperature_degc", "clock_bound_s", "unsaved_s", "bus_v"})
"""Limits beyond which the leg is still known, so that the torque may go in a ramp: a step would shake it."""


def may_ramp(trip: Trip, sample: Sample) -> bool:
    """Whether the torque may take its time after this trip. Not where it drives on towards what it passed, and never
    where a reading failed: nothing is known then."""
    if not math.isfinite(trip.value):
        return False
    if trip.limit in TRUSTED:
        return True
    torque = sample.torque_cmd_nm or 0.0
    if trip.limit == "q2_rad" and sample.q2_rad is not None:
        return torque * sample.q2_rad < 0.0
    if trip.limit == "speed_radps" and sample.q2_speed_radps is not None:
        return torque * sample.q2_speed_radps < 0.0
    return False


def ahead(angle_rad: float, speed_radps: float, stop_radps2: float, react_s: float) -> float:
    """Angle at which a joint comes to rest [rad], moving on for `react_s` before it is slowed down.

    What moves towards the middle is no nearer to the limit than it is now.
    """
    if not angle_rad * speed_radps > 0.0:
        return angle_rad if not math.isnan(speed_radps) else math.nan
    return angle_rad + speed_radps * react_s + math.copysign(speed_radps**2 / (2.0 * stop_radps2), speed_radps)


class Supervisor:
    """Checks samples against limits. The first trip latches: every later check returns it again."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.trip: Trip | None = None

    def check(self, sample: Sample) -> Trip | None:
        """None while everything is within its limit, else the first limit passed."""
        if self.trip is None:
            for name, limit, what in WATCHED:  # at each turn: no `Trip` is made of what is within its limit
                value, bound = getattr(sample, name), getattr(self.limits, limit)
                # A temperature below zero is no danger; every other quantity counts by its size.
                # So written that NaN trips.
                if value is not None and not (value if limit == "temperature_degc" else abs(value)) <= bound:
                    self.trip = Trip(limit, what, value, bound)
                    break
        return self.trip

    def watched(self, sample: Sample) -> Iterator[Trip]:
        """Everything that is checked of this sample, passed or not."""
        for name, limit, what in WATCHED:
            value = getattr(sample, name)
            if value is not None:
                yield Trip(limit, what, value, getattr(self.limits, limit))
