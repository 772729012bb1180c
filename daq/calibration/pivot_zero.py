"""The pivot sensor's reading with link 1 hanging straight down: from records of a leg at rest."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from daq.calibration.rest_detection import STILL_RAD
from daq.errors import InputError, WorkError
from daq.rig import Rig
from daq.runs import BLOCKS, Mean, RawRun, block_means, mean_of
from drivers import as5600


def resting_pivot(raw: RawRun, rig: Rig) -> Mean:
    """Mean reading of the pivot sensor at rest [rad], after its sign, zero not taken off, within half a turn of 0.

    Raises `InputError` where there is none, `WorkError` where the joint moved.
    """
    readings = raw.streams["/pivot"]
    good = readings[(readings["status"] & as5600.MD) != 0]
    if good.size < 2 * BLOCKS:
        raise InputError(raw.name, f"holds {good.size} valid readings of a pivot sensor, {2 * BLOCKS} are needed",
                         "describe the sensor under [devices.pivot] and record again")
    sign = rig.devices.pivot.sign if rig.devices.pivot else 1
    angle = sign * good["raw"].astype(float) * as5600.RADIANS_PER_COUNT
    angle = angle[0] + np.remainder(angle - angle[0] + math.pi, math.tau) - math.pi  # the chip may wrap right there
    strayed = np.abs(block_means(angle) - block_means(angle)[0])
    if strayed.max() > STILL_RAD:
        raise WorkError(f"{raw.name}: the pivot moved by {strayed.max():.3f} rad; let the leg come to rest, then "
                        "record again")
    found = mean_of(angle)
    return replace(found, value=math.remainder(found.value, math.tau))
