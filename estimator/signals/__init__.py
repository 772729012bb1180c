"""From columns to signals: filters, segments without gaps, the IMU's tilt and rate."""

from estimator.signals.channels import ACCEL_X, ACCEL_Y, GYRO, IMU_CHANNELS, Channel, Kind, encoder_of, torque_of
from estimator.signals.filters import encoder_level, lowpass, quantum, white_noise_level
from estimator.signals.imu import accelerometer, tilt
from estimator.signals.segments import (
    IMU_COLUMNS,
    STANCE,
    Kinematics,
    SignalSet,
    angle_column,
    by_run,
    differentiate,
    paper_differences,
    split_signals,
    torque_column,
)
from estimator.signals.steps import SINCE, Touchdowns, cut_steps, find_touchdowns

__all__ = [
    "ACCEL_X", "ACCEL_Y", "GYRO", "IMU_CHANNELS", "IMU_COLUMNS", "SINCE", "STANCE", "Channel", "Kind", "Kinematics",
    "SignalSet", "Touchdowns", "accelerometer", "angle_column", "by_run", "cut_steps", "differentiate",
    "encoder_level", "encoder_of", "find_touchdowns", "lowpass", "paper_differences", "quantum", "split_signals",
    "tilt", "torque_column", "torque_of", "white_noise_level",
]
