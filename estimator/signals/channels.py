"""`Channel`: which sensor a reading, or what an effect adds to one, belongs to."""

from __future__ import annotations

from typing import Literal, NamedTuple

Kind = Literal["torque", "encoder", "gyro", "accel_x", "accel_y"]


class Channel(NamedTuple):
    """One sensor: of a joint, or of the IMU."""

    kind: Kind
    joint: int | None = None
    """0-based; None for the IMU's, which sits on link 1."""

    def __str__(self) -> str:
        """For a person, the joint counted from 1."""
        return self.kind if self.joint is None else f"{self.kind}{self.joint + 1}"


GYRO, ACCEL_X, ACCEL_Y = Channel("gyro"), Channel("accel_x"), Channel("accel_y")
IMU_CHANNELS = (GYRO, ACCEL_X, ACCEL_Y)
"""In the order of `IMU_COLUMNS`."""


def torque_of(joint: int) -> Channel:
    """The measured torque of a joint, 0-based."""
    return Channel("torque", joint)


def encoder_of(joint: int) -> Channel:
    """The angle that a joint's encoder reads, 0-based."""
    return Channel("encoder", joint)
