"""`legid calibrate pivot`: records at rest into the zero of the pivot sensor, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from daq import Rig
from daq.calibration import resting_pivot, resting_q1, still_record
from daq.runs import Mean, RawRun, mean_interval
from estimator import TWO_SIDED
from experiments.calibrate.motor_off import Wanted
from experiments.calibrate.outcome import Outcome, left_by_gravity, rounded

FEWEST = 3
"""Records from which their scatter is an interval."""


def pivot_wishes(records: int) -> list[Wanted]:
    """Instructions: let the leg come to rest from either side alternately."""
    return [Wanted(f"stop {k + 1}", f"push the leg {('forwards', 'backwards')[k % 2]}, let go, wait until it hangs "
                   "still") for k in range(records)]


def calibrate_pivot(raws: Sequence[RawRun], rig: Rig) -> Outcome:
    """Zero of the pivot sensor: its reading less the angle by gravity where the IMU was recorded, else its reading.

    Raises `InputError` or `WorkError`.
    """
    c = rig.calibration
    readings = [resting_pivot(raw, rig) for raw in raws]
    by_imu = all(raw.streams["/imu"].size for raw in raws)
    angles = [resting_q1(still_record(raw), c) if by_imu else Mean(0.0, 0.0, 0.0, 0.0) for raw in raws]
    near = readings[0].value - angles[0].value
    zeros = np.array([near + math.remainder(reading.value - q1.value - near, math.tau)
                      for reading, q1 in zip(readings, angles)])
    if zeros.size >= FEWEST:
        value, half = mean_interval(zeros)
        how = f"{zeros.size} records"
    else:
        value = float(zeros.mean())
        half = max(float(np.hypot(reading.half, q1.half)) for reading, q1 in zip(readings, angles))
        how = "noise alone"
    lines = [f"{raw.name}: pivot reads {reading.value:+.5f} +- {reading.half:.1g} rad"
             + (f", link 1 hangs at {q1.value:+.5f} +- {q1.half:.1g} rad" if by_imu else "")
             for raw, reading, q1 in zip(raws, readings, angles)]
    lines += ["", f"pivot zero: {value:+.5f} +- {half:.2g} rad (95 %, from {how})",
              f"rig.toml had {c.pivot_zero_rad:+.5f} rad",
              "an error of the IMU's zero of q1 adds to it in full: an accelerometer bias of 0.1 m/s2 along the "
              f"swing gives {0.1 / rig.mechanism.gravity_mps2:.3f} rad" if by_imu else
              "without an IMU link 1 was taken to hang straight down: true with the knee straight, up to the pivot's "
              "friction"]
    warnings = [f"{raw.name}: the pivot crept by {reading.drift:+.2g} rad; let it come to rest for longer"
                for raw, reading in zip(raws, readings) if reading.drifts and abs(reading.drift) > 1e-3]
    if zeros.size < FEWEST and not by_imu:
        warnings.append(f"friction holds the pivot where it stops, which {zeros.size} of {FEWEST} records do not show: "
                        "give three or more, each reached from the other side")
    left = float(np.hypot(half / TWO_SIDED, left_by_gravity(rig) if by_imu else 0.0))
    return Outcome("\n".join(lines), {"calibration": {"pivot_zero_rad": rounded(math.remainder(value, math.tau))}},
                   warnings, {"encoder_offset.1": left} if by_imu or zeros.size >= FEWEST else {})
