"""IMU and encoder errors."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.effects.base import SensorEffect, Size, View
from estimator.model import Mechanism
from estimator.signals import ACCEL_X, ACCEL_Y, GYRO, Channel, accelerometer_at, encoder_of, total

NO_ENCODER = "this joint has no encoder on this path"


class ImuEffect(SensorEffect):
    """Base: needs the IMU path."""

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return "" if has_imu else "no IMU on this path"


class GyroBias(ImuEffect):
    """reading = q1d + b."""

    name = "gyro_bias"
    sizes = (Size("bias", "rad/s", 0.001),)
    sentence = "the gyro has a bias"
    reference = "LSM9DS1 datasheet: zero-rate level"
    experiment = "rest for a minute"
    depends_on = "v"
    plans = ("rest",)

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        return {GYRO: np.full(view.samples.q.shape[1], size[0])}


class GyroScale(ImuEffect):
    """reading = (1 + s) q1d."""

    name = "gyro_scale"
    sizes = (Size("scale_error", "1", 0.01),)
    sentence = "the gyro's scale is wrong"
    reference = "LSM9DS1 datasheet: sensitivity"
    experiment = "large swings between two known rests"
    depends_on = "v"
    plans = ("rest",)

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        return {GYRO: size[0] * _rate(view)}


class AccelerometerBias(ImuEffect):
    """reading = (a_x + b_x, a_y + b_y)."""

    name = "accelerometer_bias"
    sizes = (Size("bias_x", "m/s2", 0.01), Size("bias_y", "m/s2", 0.01))
    sentence = "the accelerometer has a bias"
    reference = "LSM9DS1 datasheet: zero-g level"
    experiment = "six positions at rest"
    plans = ("rest",)
    by_hand = "let legid calibrate see the IMU in six positions"

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        ones = np.ones(view.samples.q.shape[1])
        return {ACCEL_X: size[0] * ones, ACCEL_Y: size[1] * ones}


def true_acceleration(view: View) -> tuple[FloatArray, FloatArray]:
    """(a_x, a_y) at the samples by the nominal sensor model of the first IMU."""
    s, m = view.samples, view.mechanism
    return accelerometer_at(m, m.imus[0], s.q, s.v, s.a)


def _rate(view: View) -> FloatArray:
    """Absolute rate of the first IMU's link at the samples."""
    return total(view.samples.v, view.mechanism.joints_to(view.mechanism.imus[0].link))


class ImuMisalignment(ImuEffect):
    """The IMU is turned by phi in the sense of q1: a_x' = a_x cos phi - a_y sin phi."""

    name = "imu_misalignment"
    sizes = (Size("angle", "rad", 0.005),)
    sentence = "the IMU is mounted at an angle to the link"
    reference = "plane rotation"
    experiment = "rest hanging, and rest at a known angle"
    plans = ("rest",)
    by_hand = "hold the link at a known angle in one run"

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        ax, ay = true_acceleration(view)
        c, s = np.cos(size[0]), np.sin(size[0])
        return {ACCEL_X: (c - 1.0) * ax - s * ay, ACCEL_Y: (c - 1.0) * ay + s * ax}


class ImuLeverArm(ImuEffect):
    """The IMU sits d further from its link's joint than declared: on link 1 d q1dd, -d q1d^2."""

    name = "imu_lever_arm"
    sizes = (Size("excess", "m", 0.002),)
    sentence = "the IMU's distance from the pivot is not the declared one"
    reference = "rigid-body acceleration at the IMU, docs/theory.md, The sensors"
    experiment = "fast swings of the pivot"
    depends_on = "v"
    plans = ("fast", "swing")

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        joints = view.mechanism.joints_to(view.mechanism.imus[0].link)
        return {ACCEL_X: size[0] * total(view.samples.a, joints), ACCEL_Y: -size[0] * _rate(view) ** 2}


class EncoderEffect(SensorEffect):
    """Base: the joint's own encoder reads wrong."""

    per_joint = True

    def error(self, q: FloatArray, size: FloatArray) -> FloatArray:
        """Error (N,) at angle q (N,) [rad]."""
        raise NotImplementedError

    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        j = self.joint or 0
        return {encoder_of(j): self.error(view.samples.q[j], size)}

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        return NO_ENCODER if has_imu and self.joint == 0 else ""


class EncoderOffset(EncoderEffect):
    """reading = q + o."""

    name = "encoder_offset"
    sizes = (Size("offset", "rad", 0.005),)
    sentence = "the encoder's zero is wrong"
    reference = "docs/formats.md: q2 = 0 is straight"
    experiment = "rest hanging straight"
    plans = ("rest",)

    def error(self, q: FloatArray, size: FloatArray) -> FloatArray:
        return np.full_like(q, size[0])


class EncoderScale(EncoderEffect):
    """reading = (1 + s) q."""

    name = "encoder_scale"
    sizes = (Size("scale_error", "1", 0.01),)
    sentence = "the encoder's scale is wrong (counts or gear ratio)"
    reference = "counts per turn"
    experiment = "a full turn between two known stops"
    plans = ("ramps",)
    by_hand = "turn the joint by hand from one known stop to the other in one run"

    def error(self, q: FloatArray, size: FloatArray) -> FloatArray:
        return size[0] * q


class EncoderEccentricity(EncoderEffect):
    """reading = q + a sin q + b (cos q - 1): once a turn of the measured angle."""

    name = "encoder_eccentricity"
    sizes = (Size("sine_amplitude", "rad", 0.005), Size("cosine_amplitude", "rad", 0.005))
    sentence = "the encoder's disc is off centre: an error once a turn"
    reference = "eccentricity of a graduated disc: first harmonic of the angle measured"
    experiment = "a full slow turn"
    plans = ("steady", "ramps")

    def error(self, q: FloatArray, size: FloatArray) -> FloatArray:
        return size[0] * np.sin(q) + size[1] * np.cos(q)
