"""`legid calibrate imu`: still records from files or from the chip, results into words and rig.toml."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from daq import ImuDevice
from daq.calibration import AccelCalibration, GyroCalibration, StillRecord, calibrate_accel, calibrate_gyro, from_counts
from drivers import I2CBus, Lsm9ds1, SelfTest
from experiments.console import text_table

POSITIONS = 6
DRAIN_EVERY_S = 0.01
AXES = [f"{sensor} {axis}" for sensor in ("gyro", "accel") for axis in "xyz"]


def record_still(imu: Lsm9ds1, seconds: float, name: str) -> StillRecord:
    """Samples of an open IMU for so long, from behind the last gap on. Raises a `DriverError`."""
    imu.drain()  # what gathered in the FIFO while somebody turned the chip
    parts: list[np.ndarray] = []
    first_ns = last_ns = time.monotonic_ns()
    end_ns = first_ns + round(seconds * 1e9)
    while last_ns < end_ns:
        time.sleep(DRAIN_EVERY_S)
        batch = imu.drain()
        if batch.gap_before:
            parts, first_ns = [], last_ns
        parts.append(batch.raw)
        last_ns = batch.t_after_ns
    counts = np.vstack(parts)
    return from_counts(name, counts, len(counts) / ((last_ns - first_ns) * 1e-9), imu.scale)


def calibrate(records: Sequence[StillRecord], gravity_mps2: float) -> tuple[GyroCalibration, AccelCalibration | None]:
    """Gyro from the longest record, accelerometer when there are six. Raises `WorkError`."""
    longest = max(records, key=lambda record: record.seconds)
    accel = calibrate_accel(records, gravity_mps2) if len(records) == POSITIONS else None
    return calibrate_gyro(longest), accel


def calibration_values(gyro: GyroCalibration, accel: AccelCalibration | None) -> dict[str, object]:
    """Keys of rig.toml's `[calibration]` and their values."""
    values: dict[str, object] = {"gyro_bias_radps": _rounded(gyro.bias_radps)}
    if accel is not None:
        values["accel_bias_mps2"] = _rounded(accel.bias_mps2)
        values["accel_matrix"] = [_rounded(row) for row in accel.matrix]
    return values


def calibration_text(gyro: GyroCalibration, accel: AccelCalibration | None) -> str:
    """Bias, noise and Allan deviation for a person."""
    density, flicker = gyro.allan.noise_density, gyro.allan.bias_instability
    units = ["rad/s"] * 3 + ["m/s2"] * 3
    rows = [[name, unit, f"{std:.3g}", f"{n:.3g}", f"{b:.3g}"]
            for name, unit, std, n, b in zip(AXES, units, gyro.sample_std, density, flicker)]
    lines = [text_table(["signal", "unit", "one sample", "density [unit/sqrt(Hz)]", "bias instability, at most"], rows,
                        right={2, 3, 4}), "",
             "gyro bias [rad/s]: " + ", ".join(f"{b:+.5f} +- {s:.1g}" for b, s in
                                               zip(gyro.bias_radps, gyro.bias_std_radps))]
    longest = float(gyro.allan.tau_s[-1])
    lines.append(f"Allan deviations up to {longest:.3g} s of averaging; a longer record shows slower drifts")
    if accel is not None:
        lines += ["accelerometer bias [m/s2]: " + ", ".join(f"{b:+.4f}" for b in accel.bias_mps2),
                  "accelerometer scales: " + ", ".join(f"{s:.5f}" for s in np.diag(accel.matrix))
                  + f"; six positions fit to {accel.residual_mps2:.3g} m/s2"]
    return "\n".join(lines)


def self_test_text(bus: I2CBus, device: ImuDevice) -> tuple[str, bool]:
    """Outcome of the chip's self-test in words, and whether all of it passed. Raises a `DriverError`."""
    test = SelfTest(bus)
    parts = [*test.inertial(device.address)]
    if device.magnetometer is not None:
        parts.append(test.magnetic(device.magnetometer))
    return "\n".join(f"self-test: {part}" for part in parts), all(part.passed for part in parts)


def _rounded(values: np.ndarray) -> list[float]:
    return [float(f"{value:.6g}") for value in values]
