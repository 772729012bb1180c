"""Checks of the matrices of an IMU's calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence

from daq.errors import InputError

MOUNT_SLACK = 0.05
"""How far the products of a mount's rows may be off those of a rotation: rows are typed with few digits."""
LEAST_VOLUME = 0.05
"""Smallest determinant of a matrix that scales: below it one of the accelerometer's axes is lost."""
Rows = Sequence[Sequence[float]]


def check_mount(m: Rows, where: str) -> None:
    """Axes of length one at right angles: a mount without rank makes a sensor blind. Left-handed ones are a chip's own
    (the LSM9DS1's frame is drawn so); `legid calibrate mount` finds the hand."""
    for i in range(3):
        for j in range(i, 3):
            product = sum(a * b for a, b in zip(m[i], m[j]))
            if not abs(product - (i == j)) <= MOUNT_SLACK:
                what = f"row {i + 1} has length {math.sqrt(product):.3g}" if i == j and product >= 0 else \
                    f"rows {i + 1} and {j + 1} are not at right angles"
                raise InputError(where, f"calibration.imu_mount is no rotation: {what}",
                                 "give the link's axes in the chip's frame, or run legid calibrate mount")


def check_accelerometer(rows: Rows, where: str) -> None:
    """A matrix that has an inverse."""
    (a, b, d), (e, f, g), (h, i, j) = rows
    if abs(a * (f * j - g * i) - b * (e * j - g * h) + d * (e * i - f * h)) < LEAST_VOLUME:
        raise InputError(where, "calibration.accel_matrix maps several readings to one",
                         "it is near the identity; legid calibrate imu --six-positions finds it")
