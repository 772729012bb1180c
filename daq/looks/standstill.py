"""Standstill: parts of a run in which an angle stays where it is, though its torque swings as where it moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq.dataset import FloatArray
from daq.looks.jumps import scale_of

STILL = 4.0
"""An angle stands still where it stays within so many times its resolution."""
LEAST_S, LEAST_ROWS = 1.0, 50
"""Shortest standstill that is looked at."""
MOVING = 0.2
"""Share of the run, at least, in which the joint moves: else nothing says how far a torque moves it."""
INNER, OUTER = 0.05, 0.1
"""The torque of a standstill leaves so many of its samples outside the torque that moves the joint in all but the
second share of its samples, in both directions. Dry friction holds a joint against less than what moves it."""


def stands_under_torque(time_s: FloatArray, angles: Sequence[FloatArray], tau: FloatArray) -> list[tuple[int, int]]:
    """[start, stop) of the parts in which all `angles` (n,) stand still, the first under a torque (n,) that moves it
    elsewhere."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # a recording loads no mathematics

    window = max(LEAST_ROWS, round(LEAST_S / max(float(np.median(np.diff(time_s))), 1e-9)))
    if tau.size < 4 * window or np.ptp(angles[0]) == 0.0:
        return []
    still = np.all([maximum_filter1d(q, window) - minimum_filter1d(q, window) <= STILL * scale_of(q).resolution
                    for q in angles], axis=0)
    whole = maximum_filter1d(still.astype(np.int8), window) > 0
    if np.mean(~whole) < MOVING:
        return []
    low, high = np.quantile(tau[~whole], [OUTER, 1.0 - OUTER])
    edges = np.diff(np.concatenate(([False], whole, [False])).astype(np.int8))
    found = []
    for start, stop in zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist()):
        own_low, own_high = np.quantile(tau[start:stop], [INNER, 1.0 - INNER])
        if own_low <= low < high <= own_high:
            found.append((start, stop))
    return found
