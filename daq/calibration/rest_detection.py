"""Readings of the devices with the motor off and the leg at rest: knee, current, gravity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.calibration.imu import StillRecord
from daq.dataset import FloatArray
from daq.errors import InputError, WorkError
from daq.rig import Calibration
from daq.runs import BLOCKS, Mean, RawRun, block_means, mean_of

DISARMED = 0
LEAST_S = 0.8
"""The second before a run's start, when the motor is still off, is enough."""
STILL_RAD = 0.01
"""Largest deviation of the knee's mean over a twentieth of the record from that over the first."""


def resting(raw: RawRun) -> NDArray[np.void]:
    """Telemetry of the longest segment with the motor off. Raises `InputError` or `WorkError` where there is none."""
    telemetry = raw.streams["/leg/telemetry"]
    if not telemetry.size:
        raise InputError(raw.name, "holds no telemetry", "record with the leg controller")
    off = np.concatenate(([False], telemetry["state"] == DISARMED, [False])).astype(np.int8)
    starts, stops = np.flatnonzero(np.diff(off) == 1), np.flatnonzero(np.diff(off) == -1)
    if not starts.size:
        raise WorkError(f"{raw.name}: the motor was never off; record with it off")
    k = int(np.argmax(stops - starts))
    segment = telemetry[starts[k]: stops[k]]
    seconds = float(segment["host_ns"][-1] - segment["host_ns"][0]) * 1e-9
    if seconds < LEAST_S or segment.size < 2 * BLOCKS:
        raise WorkError(f"{raw.name}: the motor was off for {seconds:.2f} s, at least {LEAST_S:g} s are needed")
    knee = knee_readings(segment)
    if knee.size >= BLOCKS:
        strayed = np.abs(block_means(knee) - block_means(knee)[0])
        if strayed.max() > STILL_RAD:
            at = float(np.argmax(strayed > STILL_RAD)) / BLOCKS * seconds
            raise WorkError(f"{raw.name}: the knee moved about {at:.1f} s into the record; let the leg come to rest, "
                            "then record again")
    return segment


def knee_readings(segment: NDArray[np.void]) -> FloatArray:
    """Valid readings of the knee encoder [rad], zero not taken off."""
    readings = segment["knee_rad"].astype(np.float64)
    return readings[np.isfinite(readings)]


def resting_knee(raw: RawRun) -> Mean:
    """Mean reading of the knee encoder at rest [rad]. Raises `InputError` or `WorkError`."""
    readings = knee_readings(resting(raw))
    if readings.size < BLOCKS:
        raise InputError(raw.name, "the knee encoder gave no valid reading", "check the encoder's wiring")
    return mean_of(readings)


def resting_current(raw: RawRun) -> Mean:
    """Mean current with the motor off [A]: the shunt's offset. Raises `InputError` or `WorkError`."""
    current = resting(raw)["current_a"].astype(np.float64)
    current = current[np.isfinite(current)]
    if current.size < BLOCKS:
        raise InputError(raw.name, "holds no current reading while the motor was off", "check the current sensor")
    return mean_of(current)


def resting_q1(record: StillRecord, calibration: Calibration) -> Mean:
    """Angle of link 1 by gravity [rad], of an IMU that hung still. Raises `WorkError` when it did not."""
    record.check_still()
    accel = (record.accel_mps2 - np.asarray(calibration.accel_bias_mps2)) @ np.asarray(calibration.accel_matrix).T
    tangential, outward = (accel @ np.asarray(calibration.imu_mount)[k] for k in (0, 1))
    if float(outward.mean()) > -0.5 * float(np.linalg.norm(accel.mean(axis=0))):
        raise WorkError(f"{record.name}: gravity does not point along link 1; run legid calibrate mount first, and let "
                        "the leg hang")
    return mean_of(np.arctan2(tangential, -outward))
