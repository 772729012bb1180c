"""`Channel`: which sensor a reading, or what an effect adds to one, belongs to."""

from __future__ import annotations

from typing import Literal, NamedTuple

Kind = Literal["torque", "encoder", "gyro", "accel_x", "accel_y"]


class Channel(NamedTuple):
    """One sensor: of a joint, or of an IMU."""

    kind: Kind
    joint: int | None = None
    """0-based; an IMU's is its number in the rig's order, None the first one's."""

    def __str__(self) -> str:
        """For a person, the joint or the IMU counted from 1."""
        return self.kind if self.joint is None else f"{self.kind}{self.joint + 1}"


GYRO, ACCEL_X, ACCEL_Y = Channel("gyro"), Channel("accel_x"), Channel("accel_y")
IMU_CHANNELS = (GYRO, ACCEL_X, ACCEL_Y)
"""Of the first IMU, in the order of `IMU_COLUMNS`."""


def imu_channels(number: int) -> tuple[Channel, Channel, Channel]:
    """Gyro, accelerometer x and y of an IMU, 0-based in the rig's order."""
    own = number or None
    return Channel("gyro", own), Channel("accel_x", own), Channel("accel_y", own)


def torque_of(joint: int) -> Channel:
    """The measured torque of a joint, 0-based."""
    return Channel("torque", joint)


def encoder_of(joint: int) -> Channel:
    """The angle that a joint's encoder reads, 0-based."""
    return Channel("encoder", joint)
