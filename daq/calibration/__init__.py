"""Calibration from records at rest: IMU scales and offsets, Allan deviation, zeros of angles and current."""

from daq.calibration.imu import (
    LEAST_STILL_S,
    AccelCalibration,
    GyroCalibration,
    StillRecord,
    calibrate_accel,
    calibrate_gyro,
    from_counts,
    still_record,
)
from daq.calibration.knee_zero import FEWEST_STOPS, Stop, friction_cone, hanging_zero, straight_zero
from daq.calibration.pivot_zero import resting_pivot
from daq.calibration.rest_detection import resting_current, resting_knee, resting_q1

__all__ = [
    "FEWEST_STOPS", "LEAST_STILL_S", "AccelCalibration", "GyroCalibration", "StillRecord", "Stop",
    "calibrate_accel", "calibrate_gyro", "friction_cone", "from_counts", "hanging_zero", "resting_current",
    "resting_knee", "resting_pivot", "resting_q1", "still_record", "straight_zero"
]
