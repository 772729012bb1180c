"""Plateaus: readings of one value in a row; flat tops, frozen sensors and repeats are made of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from daq.dataset import FloatArray, IndexArray

LEAST_FLAT = 5
"""Samples on a level that are a flat top, at least, and this share of all:"""
FLAT_SHARE = 0.003
STAIRCASE = 0.5
"""A column that is constant in a larger share of its steps is a staircase, whose highest step is no flat top. The same
share of samples at the two ends of the range is a square wave."""
ABOVE_STEPS = 4.0
"""A cut peak would have been higher by more than so many of the column's smallest steps."""
LEAST_ROWS, LEAST_RUNS = 50, 40
REGULAR = 0.9
"""Share of the plateaus of a moving column that are equally long when each reading is repeated."""
MOVED_STEPS = 3.0
"""A column moves between two plateaus that differ by more than so many of its smallest steps."""
FROZEN_ROWS = 10
"""Readings of a noisy column that are equal in a row, at least, when its sensor hangs."""
NOISY, USUAL_ROWS = 0.05, 4
"""A column's noise moves its last digit where a smaller share of its neighbours is equal. It then has few plateaus
between this length and that of a sensor that hangs: a smooth column has plateaus of every length at its peaks."""


class Plateaus(NamedTuple):
    """Maximal rows of equal readings."""

    start: IndexArray
    length: IndexArray
    value: FloatArray

    @property
    def stop(self) -> IndexArray:
        """(m,) one behind the last sample of each."""
        return self.start + self.length


def plateaus_of(x: FloatArray) -> Plateaus:
    """Plateaus of x (n,), single samples included."""
    start = np.flatnonzero(np.append(True, x[1:] != x[:-1]))
    return Plateaus(start, np.diff(np.append(start, x.size)), x[start])


def smallest_step(x: FloatArray) -> float:
    """Typical smallest difference between neighbours that differ: a quantised column's step."""
    steps = np.abs(np.diff(x))
    steps = steps[steps > 0.0]
    return float(np.percentile(steps, 5.0)) if steps.size else 0.0


def flat_tops(x: FloatArray) -> list[float]:
    """Levels, highest or lowest of x (n,), at which the column is cut off: it arrives with a slope, and stands there.

    A smooth peak that stays within one quantisation step q for L samples ends with a slope s of at most 4 q / L. A
    flat top has s L / 4 far above q. Zero is no such level: a motor that is off reads zero.
    """
    if x.size < LEAST_ROWS or np.ptp(x) == 0.0:
        return []
    top, bottom = float(x.max()), float(x.min())
    inside = (x != top) & (x != bottom)
    between = inside[1:] & inside[:-1]
    if inside.mean() < 1.0 - STAIRCASE or not between.any() or np.mean(np.diff(x)[between] == 0.0) > STAIRCASE:
        return []
    found, places, step = [], plateaus_of(x), smallest_step(x)
    for level in (bottom, top):
        on = (places.value == level) & (places.length > 1)
        cut = [k for k in np.flatnonzero(on).tolist() if _height(x, places, k) > ABOVE_STEPS * step]
        samples = int(places.length[cut].sum())
        if level != 0.0 and samples >= max(LEAST_FLAT, FLAT_SHARE * x.size) and places.length[cut].max() > 2:
            found.append(level)
    return found


def _height(x: FloatArray, places: Plateaus, k: int) -> float:
    """By how much a smooth peak of the same slopes would exceed this plateau."""
    first, last = int(places.start[k]), int(places.stop[k]) - 1
    level = x[first]
    slopes = [abs(x[i] - x[j]) for i, j in ((first - 1, first - 2), (last + 1, last + 2))
              if 0 <= j < x.size and abs(x[j] - level) >= abs(x[i] - level)]
    return 0.25 * float(places.length[k] * np.mean(slopes)) if slopes else 0.0


def repeats(x: FloatArray) -> int:
    """Number of samples for which each reading of x (n,) stands while the column moves; 1 without repeats."""
    places = plateaus_of(x)
    if places.start.size < LEAST_RUNS:
        return 1
    jumps = np.abs(np.diff(places.value)) > MOVED_STEPS * smallest_step(x)
    moving = jumps[1:] & jumps[:-1]
    lengths = places.length[1:-1][moving]
    if lengths.size < LEAST_RUNS:
        return 1
    usual = int(np.median(lengths))
    regular = usual > 1 and np.mean(np.abs(lengths - usual) <= 1) >= REGULAR and np.mean(lengths == 1) < 1.0 - REGULAR
    return usual if regular else 1


def frozen_noise(x: FloatArray) -> list[tuple[int, int]]:
    """[start, stop) of rows in which a noisy column repeats one reading other than 0: its sensor hangs.

    A rate that was made from an angle is 0 at rest.
    """
    places = plateaus_of(x)
    long = (places.length >= FROZEN_ROWS) & (places.value != 0.0)
    others = x.size - int(places.length[long].sum())
    equal = int((places.length[~long] - 1).sum())
    between = int(((places.length >= USUAL_ROWS) & ~long).sum())
    if others < LEAST_ROWS or equal > NOISY * others or between > long.sum():
        return []
    return list(zip(places.start[long].tolist(), places.stop[long].tolist()))
