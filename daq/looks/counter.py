"""Counters of time that wrap: of 16, 24 or 32 bits, or a time of day."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.dataset import FloatArray

BITS = (16, 24, 31, 32)
TICKS_S = (1e-9, 1e-6, 1e-3, 1.0)
"""Units of a counter [s]."""
DAY = (3600.0, 43200.0, 86400.0)
"""Clocks of an hour, half a day and a day [s]."""
RANGES_S = (*DAY, *(2.0**bits * tick for bits in BITS for tick in TICKS_S))
PERIODS = 20.0
"""Behind a wrap the next sample comes within so many usual periods."""
MOST_WRAPS = 0.02
"""Share of the rows that may be wraps."""


def unwrapped_counter(time: FloatArray, unit_s: float = 1.0) -> tuple[FloatArray, float, NDArray[np.intp]] | None:
    """(n,) `time` made increasing again, the range by which its counter wraps, and the first row behind each wrap.

    `time` is in units of `unit_s` [s]. None where it does not run backwards, or no usual range explains that.
    """
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0.0)
    ahead = steps[steps > 0.0]
    if not back.size or not ahead.size or back.size > max(MOST_WRAPS * time.size, 1):
        return None
    period = float(np.median(ahead))
    most = float(np.nanmax(time))
    for modulus in sorted(one / unit_s for one in (*RANGES_S, *(2.0**bits * unit_s for bits in BITS))):
        missing = steps[back] + modulus
        if most < modulus * (1.0 + 1e-9) + period and ((missing > 0.0) & (missing < PERIODS * period)).all():
            turns = np.zeros(time.size)
            turns[back + 1] = 1.0
            return time + modulus * np.cumsum(turns), modulus, back + 1
    return None
