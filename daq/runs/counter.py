"""Times that run backwards: counters of 16 to 32 bits and times of day that wrap, and clocks that start again."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from daq.dataset import FloatArray, IndexArray
from daq.findings import Flag

BITS = (16, 24, 31, 32)
TICKS_S = (1e-9, 1e-6, 1e-3, 1.0)
"""Units of a counter [s]."""
DAY_S = (3600.0, 43200.0, 86400.0)
"""Clocks of an hour, half a day and a day [s]."""
LEAST_PERIOD, MOST_PERIODS = 0.3, 3.0
"""Behind a wrap the next sample comes after so many usual periods."""
MOST_WRAPS = 0.02
"""Share of the rows that may be wraps."""
RESTARTS = 3
"""A file with at most so many steps back holds several runs; with more, its rows are unsorted."""


class Unwrapped(NamedTuple):
    """Times that increase again."""

    time: FloatArray
    """(n,) in the unit given."""
    modulus: float
    """Range by which the counter wraps, in that unit."""
    rows: IndexArray
    """First row behind each wrap."""

    def flag(self, column: str) -> Flag:
        """A sentence on the correction, as a flag."""
        often = f"{self.rows.size} times" if self.rows.size > 1 else "once"
        first = int(self.rows[0]) + 1
        return Flag("readings", f"{column} wraps {often} by {self.modulus:.10g} (first in row {first}), as a counter "
                    "or a time of day does: it goes on")


def unwrapped_counter(time: FloatArray, unit_s: float = 1.0) -> Unwrapped | None:
    """`time` (n,), in units of `unit_s` [s], made increasing again.

    None where it does not run backwards, or the range of no usual counter explains that.
    """
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0.0)
    ahead = steps[steps > 0.0]
    if not back.size or not ahead.size or back.size > max(MOST_WRAPS * time.size, 1):
        return None
    period, most = float(np.median(ahead)), float(np.nanmax(time))
    ranges = {one / unit_s for one in DAY_S} | {2.0**bits * tick / unit_s for bits in BITS for tick in TICKS_S}
    for modulus in sorted(ranges | {2.0**bits for bits in BITS}):
        missing = steps[back] + modulus
        if most < modulus + period and ((missing > LEAST_PERIOD * period) & (missing < MOST_PERIODS * period)).all():
            turns = np.zeros(time.size)
            turns[back + 1] = 1.0
            return Unwrapped(time + modulus * np.cumsum(turns), modulus, back + 1)
    return None


def restart_remedy(time: FloatArray, where: str) -> str:
    """The remedy for a clock that starts again at `where`: sorting would mix the runs. Empty for unsorted rows."""
    back = int(np.sum(np.diff(time) < 0.0))
    return f"the clock starts again there: cut the file at {where}, one file a run" if 0 < back <= RESTARTS else ""
