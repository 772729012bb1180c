"""Readings as the sensors of a lab give them, a little wrong in all ways at once; physics written out anew."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from daq import Dataset

SMALL = {"gyro_scale": 0.009, "accelerometer_bias.x": -0.12, "accelerometer_bias.y": 0.09, "imu_misalignment": 0.012,
         "imu_lever_arm": 0.003, "torque_offset": -0.006}
"""A lab's faults, within twice the default tolerances."""


def read_with(data: Dataset, faults: Mapping[str, float]) -> Dataset:
    """What sensors with these faults would have read."""
    c, t = dict(data.columns), data.time_s
    turn = faults.get("imu_misalignment", 0.0)
    x = c["accel_x_mps2"] + faults.get("imu_lever_arm", 0.0) * np.gradient(c["gyro_radps"], t)
    y = c["accel_y_mps2"] - faults.get("imu_lever_arm", 0.0) * c["gyro_radps"] ** 2
    c["accel_x_mps2"] = np.cos(turn) * x - np.sin(turn) * y + faults.get("accelerometer_bias.x", 0.0)
    c["accel_y_mps2"] = np.sin(turn) * x + np.cos(turn) * y + faults.get("accelerometer_bias.y", 0.0)
    c["gyro_radps"] = c["gyro_radps"] * (1.0 + faults.get("gyro_scale", 0.0))
    c["tau2_nm"] = c["tau2_nm"] + faults.get("torque_offset", 0.0)
    return replace(data, columns=c)
