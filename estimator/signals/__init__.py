"""Signals from columns: filters, segments without gaps, the IMU's tilt and rate."""

from estimator.signals.channels import (
    ACCEL_X,
    ACCEL_Y,
    GYRO,
    IMU_CHANNELS,
    Channel,
    encoder_of,
    imu_channels,
    torque_of,
)
from estimator.signals.commands import SUPPLY, Commands, command_columns, commands_of, earlier, input_by_law, monotone
from estimator.signals.filters import (
    SLOW_SHARE,
    added_by_delay,
    causal,
    encoder_level,
    lowpass,
    quantum,
    shifted,
    slow_part,
    white_noise_level,
)
from estimator.signals.imu import (
    IMU_COLUMNS,
    accelerometer,
    accelerometer_at,
    accelerometer_slopes,
    imu_columns,
    imu_readings,
    predicted_columns,
    tilt,
    total,
)
from estimator.signals.orientation import Kinematics, sight
from estimator.signals.segments import (
    LEAST_SEGMENT,
    STANCE,
    SignalSet,
    angle_column,
    by_run,
    cut,
    differentiate,
    is_plain,
    paper_differences,
    split_signals,
    torque_column,
    with_earlier_imu,
)
from estimator.signals.steps import SINCE, cut_steps, find_touchdowns

__all__ = [
    "ACCEL_X", "ACCEL_Y", "GYRO", "IMU_CHANNELS", "IMU_COLUMNS", "LEAST_SEGMENT", "SINCE", "SLOW_SHARE",
    "STANCE", "SUPPLY", "Channel", "Commands", "Kinematics", "SignalSet",
    "accelerometer", "accelerometer_at", "accelerometer_slopes", "added_by_delay", "angle_column", "by_run", "causal",
    "command_columns", "commands_of", "cut", "cut_steps", "differentiate", "earlier", "encoder_level",
    "encoder_of", "find_touchdowns", "imu_channels", "imu_columns", "imu_readings", "input_by_law",
    "is_plain", "lowpass", "monotone", "paper_differences", "predicted_columns", "quantum", "shifted", "sight",
    "slow_part", "split_signals", "tilt", "torque_column", "torque_of", "total", "white_noise_level",
    "with_earlier_imu",
]
