"""[limits] of rig.toml: what ends a run."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from daq.rig_types import Angle, Positive, Seconds, Table


class Limits(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits beyond which the torque goes to zero and the run stops, naming the limit."""

    torque_nm: Annotated[float, Meta(gt=0, le=1e3)] = 2.0
    speed_radps: Annotated[float, Meta(gt=0, le=1e3)] = 15.0
    q1_rad: Angle = 1.6
    q2_rad: Angle = 2.6
    temperature_degc: Annotated[float, Meta(gt=0, le=200.0)] = 70.0
    """Above zero only: cold is no danger."""
    staleness_s: Seconds = 0.1
    """Age of what is known of the leg [s]: since tick and sequence of the controller last advanced as its telemetry
    period says, and since the last sample of the IMU."""
    clock_bound_s: Seconds = 0.005
    q1_speed_radps: Positive = 8.5
    """Limit of the pivot's speed, in addition to `speed_radps`; within the gyro's range (500 dps is 8.73 rad/s)."""
    bus_v: Positive = 60.0
    """Supply [V]; 60 V DC is where protection by extra-low voltage ends."""
    stop_radps2: Positive = 100.0
    """Deceleration that gravity and friction give a joint whose torque is cut [rad/s2]: how far ahead of an angle's
    limit the torque goes. Lower it for a leg that coasts further."""
    slew_nmps: Positive = 150.0
    """Largest slew rate of a plan's torque [N m/s], over 10 ms."""
    duration_s: Annotated[float, Meta(gt=0, le=1e7)] = 1800.0
    """Longest plan [s]."""
    unsaved_s: Positive = 2.0
    """Age of what is not on the disk [s]: a motor does not outlive its measurement."""
    unchecked: tuple[Literal["q1_rad", "temperature_degc", "bus_v", "encoder_s"], ...] = ()
    """Limits that nothing on this rig can check, given up on purpose; any other that cannot be checked trips."""

    # What the devices say must be possible: how long each check may fail, and its band. See daq/recording/plausibility.
    echo_s: Seconds = 0.05
    """The drive echoes a torque that it was not asked for within the last half of `staleness_s`."""
    torque_s: Seconds = 0.05
    """Commanded and measured torque disagree by more than `torque_band_nm` and `torque_share` of the command (rms)."""
    torque_band_nm: Positive = 0.1
    """Five times the noise of a shunt of 0.02 N m, or its offset."""
    torque_share: Annotated[float, Meta(gt=0, lt=1)] = 0.35
    """A drive that saturates, or follows late, stays within; one that is dead (1) or reversed (2) does not."""
    encoder_s: Seconds = 0.01
    """The knee's encoder and its Hall angle disagree by more than `encoder_band_rad` over 0.25 s, or by half of it
    where one of them stands still to the digit."""
    encoder_band_rad: Positive = 0.04
    """Six counts of a Hall angle of 1024 a turn of the joint."""
    imu_stuck_s: Seconds = 0.08
    """Gyro or accelerometer repeat one reading of three axes, noise and all; at least ten samples."""
    imu_rail_s: Seconds = 0.05
    """An axis of the IMU is at the end of its range. An impact is shorter."""
    pivot_s: Seconds = 0.03
    """The gyro and the pivot's Hall angle disagree by more than `pivot_band_rad` over 0.25 s, or by half of it
    where one of them stands still to the digit."""
    pivot_band_rad: Positive = 0.04
    """The same; the speed times 15 ms comes on top, by which the two may be apart in time."""
