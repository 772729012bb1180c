"""Conversion of the devices' readings to the units of the contract, by the rig's calibration."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from daq.dataset import FloatArray
from daq.rig import Calibration, Rig
from drivers import as5600

Reading = TypeVar("Reading", float, FloatArray)
"""One reading or many."""


def imu_columns(raw: NDArray[np.int16], scale: tuple[float, float], calibration: Calibration) -> dict[str, FloatArray]:
    """Gyro and accelerometer in the link's frame from raw counts (n, 6), gyro x y z first.

    `scale`: (rad/s, m/s2) per count. Biases and `accel_matrix` are of the chip's axes and go first; the rows of
    `imu_mount` are the contract's axes: x tangential, y outwards, z the one about which the gyro reads q1d.
    """
    gyro = raw[:, :3] * scale[0] - np.asarray(calibration.gyro_bias_radps)
    accel = (raw[:, 3:] * scale[1] - np.asarray(calibration.accel_bias_mps2)) @ np.asarray(calibration.accel_matrix).T
    mount = np.asarray(calibration.imu_mount)
    linked = accel @ mount[:2].T
    return {"gyro_radps": gyro @ mount[2], "accel_x_mps2": linked[:, 0], "accel_y_mps2": linked[:, 1]}


def knee_angle(knee_rad: Reading, calibration: Calibration) -> Reading:
    """q2 [rad] from the knee encoder's reading."""
    return knee_rad - calibration.knee_zero_rad


def joint_torque(current_a: Reading, calibration: Calibration) -> Reading:
    """Knee torque [N m] from the shunt's current."""
    return (current_a - calibration.shunt_offset_a) * calibration.torque_constant_nm_per_a


def pivot_angle(raw: int, rig: Rig, near_rad: float = 0.0) -> float:
    """q1 [rad] from the pivot sensor's counts, of the turn that is nearest to `near_rad`."""
    sign = rig.devices.pivot.sign if rig.devices.pivot else 1
    angle = sign * raw * as5600.RADIANS_PER_COUNT - rig.calibration.pivot_zero_rad
    return near_rad + math.remainder(angle - near_rad, math.tau)


def second_torque(current_a: FloatArray, rig: Rig) -> FloatArray:
    """Knee torque [N m] from the current [A] of the shunt in [devices.shunt], by the constant of the drive's."""
    sign = rig.devices.shunt.sign if rig.devices.shunt else 1
    c = rig.calibration
    return (sign * current_a - c.second_shunt_offset_a) * c.torque_constant_nm_per_a
