"""Sensors without a clock: a sample's time is the host's, between request and reply, less what the chip takes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.dataset import FloatArray
from daq.rig import Rig
from daq.runs import RawRun
from daq.si_units import pivot_angle, second_torque
from daq.timing.notes import configured, increasing, unusable
from daq.timing.resample import TimedColumns
from drivers import as5600

STALLED_S = 0.005
"""A transfer that took longer was held up: nobody knows at which end, so its sample is a gap."""
COVERED = 95.0
"""Percent of the samples for which the bound on their time holds."""


def pivot_channel(raw: RawRun, rig: Rig, epoch_ns: int) -> tuple[TimedColumns, float]:
    """`q1_rad` [rad] of the pivot sensor, not wrapped, and the bound on its samples' times [s].

    The chip's filter settles within `as5600.SETTLING_S`, so an angle is between nothing and that old. A reading without
    a magnet is a gap. The first angle is taken from the turn that is nearest to hanging, each further one from the turn
    that is nearest to the one before: right while the joint turns by less than half a turn between two readings.
    """
    readings = raw.streams["/pivot"]
    middle, half_s = _times(readings["host_before_ns"], readings["host_after_ns"], epoch_ns)
    middle -= 0.5e9 * as5600.SETTLING_S
    rows = increasing(middle)
    readings, middle, half_s = readings[rows], middle[rows], half_s[rows]
    angle, near = np.full(rows.size, np.nan), 0.0
    good = (readings["status"] & as5600.MD).astype(bool) & (half_s >= 0.0) & (half_s < STALLED_S)
    for k in np.flatnonzero(good).tolist():
        angle[k] = near = pivot_angle(int(readings["raw"][k]), rig, near)
    bound_s = float(np.percentile(half_s, COVERED)) + 0.5 * as5600.SETTLING_S
    return TimedColumns(middle * 1e-9, {"q1_rad": angle}), bound_s


def shunt_channel(raw: RawRun, rig: Rig, epoch_ns: int) -> TimedColumns:
    """`tau2_shunt_nm` [N m] of the second shunt.

    A reading is the mean of a conversion that ended at most its own length T before it was read, anywhen: its middle is
    T before the reading, give or take T/2. Raises `InputError` where the run lacks the chip's scale.
    """
    facts, readings = configured(raw, "shunt"), raw.streams["/shunt"]
    try:
        scale, conversion_s = float(facts["amperes_per_count"]), float(facts["conversion_s"])
    except (KeyError, TypeError, ValueError):
        raise unusable(raw, "holds readings of a second shunt without their scale") from None
    if not (0.0 < scale < 1e3 and 0.0 < conversion_s < 10.0):
        raise unusable(raw, f"gives its second shunt {scale:g} A a count and {conversion_s:g} s a conversion")
    middle, half_s = _times(readings["host_before_ns"], readings["host_after_ns"], epoch_ns)
    rows = increasing(middle)
    torque = second_torque(readings["raw"][rows] * scale, rig)
    good = (readings["flags"][rows] == 0) & (half_s[rows] >= 0.0) & (half_s[rows] < STALLED_S)
    return TimedColumns(middle[rows] * 1e-9 - conversion_s, {"tau2_shunt_nm": np.where(good, torque, np.nan)})


def _times(before: NDArray[np.int64], after: NDArray[np.int64], epoch_ns: int) -> tuple[FloatArray, FloatArray]:
    """Middle of each transfer [ns after epoch], and half of its length [s]."""
    half_ns = 0.5 * (after - before).astype(float)
    return (before - epoch_ns).astype(float) + half_ns, half_ns * 1e-9
