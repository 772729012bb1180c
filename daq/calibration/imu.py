"""IMU calibration from records at rest: gyro bias and noise from one, accelerometer bias and matrix from six."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.calibration.allan import AllanCurve, allan_curve
from daq.dataset import FloatArray
from daq.errors import InputError, WorkError
from daq.runs import RawRun
from daq.timing import configured, fit_samples

BLOCK_S = 0.5
STILL_RADPS = 0.02
"""Largest deviation of the gyro's mean over a block from the record's median for an IMU at rest."""
STILL_MPS2 = 0.3
LEAST_STILL_S = 5.0
UPRIGHT = 0.9
"""Share of gravity that one axis must carry in a position of the six."""
AXES = ("+x", "-x", "+y", "-y", "+z", "-z")


@dataclass(frozen=True)
class StillRecord:
    """Readings of an IMU that lay still, in the chip's axes."""

    name: str
    rate_hz: float
    gyro_radps: FloatArray
    """(n, 3) [rad/s], nothing taken off."""
    accel_mps2: FloatArray
    """(n, 3) [m/s2], nothing taken off."""

    @property
    def seconds(self) -> float:
        """Length [s]."""
        return self.gyro_radps.shape[0] / self.rate_hz

    def check_still(self) -> None:
        """Raises `WorkError` saying when the IMU moved, or that the record is too short."""
        if self.seconds < LEAST_STILL_S:
            raise WorkError(f"{self.name}: {self.seconds:.1f} s at rest are too short, at least {LEAST_STILL_S:g} s "
                            "are needed")
        for values, allowed in ((self.gyro_radps, STILL_RADPS), (self.accel_mps2, STILL_MPS2)):
            size = max(int(BLOCK_S * self.rate_hz), 1)
            blocks = values[: values.shape[0] // size * size].reshape(-1, size, 3).mean(axis=1)
            strayed = np.abs(blocks - np.median(blocks, axis=0)).max(axis=1)
            if strayed.max() > allowed:
                at = float(np.argmax(strayed > allowed)) * BLOCK_S
                raise WorkError(f"{self.name}: the IMU moved about {at:.1f} s into the record; keep it still and "
                                "record again")


@dataclass(frozen=True)
class GyroCalibration:
    """Result of one record at rest."""

    bias_radps: FloatArray
    """(3,) chip's axes."""
    bias_std_radps: FloatArray
    """(3,) standard error of the bias, from the curve at the record's longest averaging time."""
    allan: AllanCurve
    """Of gyro x y z, then accelerometer x y z."""
    sample_std: FloatArray
    """(6,) standard deviation of one sample, high-passed: what `[noise]` means at the IMU's rate."""


@dataclass(frozen=True)
class AccelCalibration:
    """Result of six positions: calibrated = matrix @ (reading - bias)."""

    bias_mps2: FloatArray
    matrix: FloatArray
    residual_mps2: float
    """RMS of what the six positions leave, from 6 degrees of freedom."""


def still_record(raw: RawRun) -> StillRecord:
    """The longest segment without a gap of a run's IMU. Raises `InputError` when it has none."""
    samples, facts = raw.streams["/imu"], configured(raw, "imu")
    if not samples.size or not facts:
        raise InputError(raw.name, "holds no IMU samples with their scale", "record with an IMU")
    epoch_ns = int(samples["drain_before_ns"][0])
    rate = fit_samples(samples, epoch_ns).rate_hz
    if not np.isfinite(rate):
        raise InputError(raw.name, "is too short for the IMU's rate", "record for longer")
    segment = np.cumsum(samples["gap_before"])
    longest = np.flatnonzero(segment == np.bincount(segment.astype(int)).argmax())
    counts = np.column_stack([samples[f"{kind}_{axis}"][longest] for kind in ("gyro", "accel") for axis in "xyz"])
    return from_counts(raw.name, counts, rate, (facts["gyro_radps_per_lsb"], facts["accel_mps2_per_lsb"]))


def from_counts(name: str, counts: NDArray[np.int16], rate_hz: float, scale: tuple[float, float]) -> StillRecord:
    """A record from raw counts (n, 6), gyro first; `scale` (rad/s, m/s2) per count."""
    values = counts.astype(np.float64)
    return StillRecord(name, rate_hz, values[:, :3] * scale[0], values[:, 3:] * scale[1])


def calibrate_gyro(record: StillRecord) -> GyroCalibration:
    """Bias and noise of a still record. Raises `WorkError` when it was not still or is too short."""
    record.check_still()
    values = np.hstack([record.gyro_radps, record.accel_mps2])
    curve = allan_curve(values, record.rate_hz)
    sample_std: FloatArray = np.std(np.diff(values, axis=0), axis=0) / np.sqrt(2.0)
    return GyroCalibration(record.gyro_radps.mean(axis=0), curve.sigma[-1, :3], curve, sample_std)


def calibrate_accel(records: Sequence[StillRecord], gravity_mps2: float) -> AccelCalibration:
    """Bias and matrix from six still records, each with another axis up or down, in any order.

    At rest the axis that points up reads +g. With reading = D u + b and u = +-g along one axis, the columns of D are
    half the differences of opposite positions, b the mean of all six; the matrix is D's inverse. Raises `WorkError`
    naming the position that is missing or given twice, or the record that moved.
    """
    found: dict[str, FloatArray] = {}
    for record in records:
        record.check_still()
        mean: FloatArray = record.accel_mps2.mean(axis=0)
        position = _position(record.name, mean, gravity_mps2)
        if position in found:
            raise WorkError(f"{record.name}: position {position} is there twice; the six are {', '.join(AXES)} up")
        found[position] = mean
    missing = [axis for axis in AXES if axis not in found]
    if missing:
        raise WorkError(f"six positions are needed, {', '.join(missing)} up missing; record each with the chip lying "
                        "still")
    readings = np.array([found[axis] for axis in AXES])
    distortion = (readings[0::2] - readings[1::2]).T / (2.0 * gravity_mps2)
    bias: FloatArray = readings.mean(axis=0)
    matrix: FloatArray = np.linalg.inv(distortion)
    truth = gravity_mps2 * np.repeat(np.eye(3), 2, axis=0) * np.array([1.0, -1.0] * 3)[:, None]
    left = (readings - bias) @ matrix.T - truth
    return AccelCalibration(bias, matrix, float(np.sqrt(np.sum(left**2) / 6.0)))


def _position(name: str, mean: FloatArray, gravity_mps2: float) -> str:
    axis = int(np.argmax(np.abs(mean)))
    share = abs(float(mean[axis])) / float(np.linalg.norm(mean))
    if share < UPRIGHT or not 0.7 < abs(float(mean[axis])) / gravity_mps2 < 1.3:
        raise WorkError(f"{name}: no axis points up or down (readings {', '.join(f'{v:.2f}' for v in mean)} m/s2); lay "
                        "the chip on one of its faces")
    return ("+" if mean[axis] > 0 else "-") + "xyz"[axis]
