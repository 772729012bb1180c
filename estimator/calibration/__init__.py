"""Sensors calibrated by a motion: IMU against encoder, IMU's mount, encoders' zeros, a distance meter."""

from estimator.calibration.encoder_zeros import differing_text, find_differing, find_zeros, subtract, zeros_text
from estimator.calibration.imu_encoder import ACCEL, SIGNALS, EncoderFit, Found, Stretch, fit_imu
from estimator.calibration.imu_mount import MountFit, Readings, fit_mount

__all__ = [
    "ACCEL", "SIGNALS", "EncoderFit", "Found", "MountFit", "Readings", "Stretch", "differing_text",
    "find_differing", "find_zeros", "fit_imu", "fit_mount", "subtract", "zeros_text"
]
