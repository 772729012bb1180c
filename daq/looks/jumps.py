"""Jumps of an angle that no joint makes: wraps, single wrong readings, steps of the zero, and two senders in turn."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.dataset import FloatArray
from daq.looks.plateaus import smallest_step

TURNS = tuple(2.0 * np.pi / k for k in (1, 2, 3, 4))
"""Ranges over which an angle in rad is usually wrapped."""
NEAR_TURN = 0.01
"""A wrap is as large as its range to this share, and to the column's usual changes of its steps."""
MOST_OTHERS = 2
"""Large jumps in addition to the wraps, at most, or as many as there are wraps."""
SPAN_SHARE = 0.7
"""A wrap moves the reading by more than this share of the column's range."""
EDGE_STEPS, EDGE_SHARE, MOST_EDGE = 4.0, 0.02, 0.3
"""A wrap leads from one end of the range to the other: within so many of the column's fastest steps and the first share
of the range, which together are at most the second share: a column of noise wraps nowhere."""
UNKNOWN_WRAPS = 3
"""Wraps by a range that is no usual one, at least."""
LONGEST_ISOLATED = 3
RATE_SHARE = 97.0
"""Percentile of the column's steps that is its usual fastest one."""
FASTEST, CHANGES, SMALLEST, NEIGHBOURS = 1.5, 12.0, 20.0, 4.0
"""A jump is none of a joint if it exceeds so many times the fastest step, the usual change of steps, the smallest step,
and the changes of its neighbours. (An impact that reverses the speed moves a reading by one fastest step at most.)"""
HELD_ROWS = 4
"""Equal readings in front of a jump, at least, that were a frozen sensor."""
NEAR_LAGS, IN_TURN, IN_TURN_TIMES = 4, 0.1, 10.0
"""Two series take turns where more than this share of the steps is so many times the distance to the nearest of the
last four readings."""
IN_TURN_SPAN = 0.05


class Jumps(NamedTuple):
    """Places at which a column jumps."""

    isolated: list[tuple[int, int]]
    """[start, stop) of readings that are off, with good ones on both sides."""
    steps: list[tuple[int, float]]
    """First sample behind a step, and its size."""


def unwrapped(x: FloatArray) -> tuple[FloatArray, float, NDArray[np.intp]] | None:
    """x (n,) without wraps, the range of the wraps, and the first sample behind each; None where x does not wrap.

    A wrap leads from one end of the range to the other, or does so over a few wrong readings. Large jumps that do not
    are left to other looks.
    """
    steps = np.diff(x)
    middle = np.sort(np.stack([x[:-2], x[1:-1], x[2:]]), axis=0)[1]  # without single readings
    ends = (float(middle.min()), float(middle.max())) if x.size > 2 else (0.0, 0.0)
    big = np.abs(steps) > SPAN_SHARE * (ends[1] - ends[0])
    if x.size < 5 or np.count_nonzero(~big) < 2:
        return None
    usual = float(np.percentile(np.abs(steps[~big]), RATE_SHARE))
    change = CHANGES * float(np.percentile(np.abs(np.diff(steps[~big])), RATE_SHARE))
    at = np.flatnonzero(big)
    smooth = np.where(big, 0.0, steps)
    jumps = steps[at] - 0.5 * (smooth[np.maximum(at - 1, 0)] + smooth[np.minimum(at + 1, steps.size - 1)])
    for modulus in (*TURNS, *([float(np.median(np.abs(jumps)))] if at.size else [])):
        limits = _Limits(modulus, EDGE_STEPS * usual + EDGE_SHARE * modulus, change + NEAR_TURN * modulus, ends)
        if limits.slack > MOST_EDGE * modulus or ends[1] - ends[0] > modulus + limits.slack:
            continue
        fits = np.array([limits.wraps(jump, x[k], x[k + 1]) for k, jump in zip(at.tolist(), jumps)], bool)
        known, count = modulus in TURNS, int(fits.sum())
        few = count < (1 if known else UNKNOWN_WRAPS) or at.size - count > max(count, MOST_OTHERS)
        turned = np.zeros(x.size)
        if not few:
            turned[at[fits] + 1] = np.sign(jumps[fits])
        elif not known:
            continue
        out, over = _over_isolated(x - modulus * np.cumsum(turned), x, limits, usual)
        if not few or over:
            return out, modulus, np.sort(np.concatenate([np.flatnonzero(turned), np.array(over, dtype=np.intp)]))
    return None


class _Limits(NamedTuple):
    """What makes a jump a wrap."""

    modulus: float
    slack: float
    """How far from the ends of the range it may lead."""
    off: float
    """How far its size may be from the range."""
    ends: tuple[float, float]

    def wraps(self, jump: float, before: float, behind: float) -> bool:
        """Whether a jump between two readings, beyond their rate, leads from one end to the other."""
        low, high = min(before, behind) - self.ends[0], self.ends[1] - max(before, behind)
        return (abs(abs(jump) - self.modulus) <= min(self.off, self.slack) and abs(low) <= self.slack
                and abs(high) <= self.slack)


def _over_isolated(y: FloatArray, x: FloatArray, limits: _Limits, usual: float) -> tuple[FloatArray, list[int]]:
    """y (n,) without the wraps that have wrong readings of x in between, and the first good sample behind each."""
    far = np.flatnonzero(np.abs(np.diff(y)) > max(EDGE_STEPS * usual, EDGE_SHARE * limits.modulus))
    groups = np.split(far, np.flatnonzero(np.diff(far) > LONGEST_ISOLATED) + 1) if far.size else []
    out, found = y.copy(), list[int]()
    for group in groups:
        last, behind = int(group[0]), int(group[-1]) + 1
        if not 2 <= behind - last <= LONGEST_ISOLATED + 1 or last < 1 or behind > y.size - 2:
            continue
        own = 0.5 * (y[last] - y[last - 1] + y[behind + 1] - y[behind])
        jump = y[behind] - y[last] - own * (behind - last)
        if not limits.wraps(jump, x[last], x[behind]):
            continue
        out[behind:] -= np.sign(jump) * limits.modulus
        line = np.linspace(out[last], out[behind], behind - last + 1)[1:-1]
        between = out[last + 1:behind]
        out[last + 1:behind] = between + limits.modulus * np.rint((line - between) / limits.modulus)
        found.append(behind)
    return out, found


def find_jumps(x: FloatArray, apart: NDArray[np.bool_]) -> Jumps:
    """Isolated wrong readings and steps of x (n,); `apart` (n - 1,): pairs with a pause in between, which may jump."""
    if x.size < 10:
        return Jumps([], [])
    steps = np.where(apart, 0.0, np.diff(x))
    change = np.abs(steps[1:-1] - 0.5 * (steps[2:] + steps[:-2]))
    least = max(FASTEST * float(np.percentile(np.abs(steps), RATE_SHARE)),
                CHANGES * float(np.percentile(change, 95.0)), SMALLEST * smallest_step(x))
    suspects = np.flatnonzero(np.abs(steps) > 0.5 * least) + 1
    isolated, steps_found, good = [], [], 0
    for first in suspects.tolist():
        if first < good:
            continue
        stop = _back(x, first, least)
        if stop:
            isolated.append((first, stop))
            good = stop + 1
            continue
        size = _step(x, first, least)
        if size:
            steps_found.append((first, size))
    return Jumps(isolated, steps_found)


def _rates(x: FloatArray, first: int, stop: int) -> FloatArray:
    """Steps between the two samples before `first`, and those from `stop` on."""
    return np.concatenate([np.diff(x[max(first - 3, 0):first]), np.diff(x[stop:stop + 3])])


def _back(x: FloatArray, first: int, least: float) -> int:
    """One behind the last of a few readings from `first` on that are far off the line between their neighbours; 0 where
    there are none."""
    for stop in range(first + 1, min(first + LONGEST_ISOLATED, x.size - 2) + 1):
        line = np.linspace(x[first - 1], x[stop], stop - first + 2)
        off = float(np.min(np.abs(x[first:stop] - line[1:-1])))
        rates = _rates(x, first, stop)
        if off > least and rates.size > 2 and off > NEIGHBOURS * float(np.max(np.abs(rates - (line[1] - line[0])))):
            return stop
    return 0


def _step(x: FloatArray, first: int, least: float) -> float:
    """Size of a step between `first` - 1 and `first` beyond the motion of its neighbours; 0 where there is none."""
    before, behind = np.diff(x[max(first - 3, 0):first]), np.diff(x[first:first + 3])
    if before.size < 2 or behind.size < 2:
        return 0.0
    own = 0.5 * (before[-1] + behind[0])
    size = float(x[first] - x[first - 1] - own)
    changes = max(abs(before[1] - before[0]), abs(behind[1] - behind[0]), abs(behind[0] - before[-1]))
    return size if abs(size) > max(least, NEIGHBOURS * changes) else 0.0


def held_before(x: FloatArray, first: int) -> int:
    """First of the equal readings that end at `first` - 1; `first` where they are few."""
    start = first - 1
    while start > 0 and x[start - 1] == x[first - 1]:
        start -= 1
    return start if first - start >= HELD_ROWS else first


def take_turns(x: FloatArray) -> bool:
    """Whether two series take turns in x (n,): neighbours are far apart, readings a few samples before are near."""
    if x.size < 10 * NEAR_LAGS or np.ptp(x) == 0.0:
        return False
    lags = np.array([np.abs(x[NEAR_LAGS:] - x[NEAR_LAGS - lag:x.size - lag]) for lag in range(1, NEAR_LAGS + 1)])
    near = float(np.median(lags.min(axis=0)))
    far = lags[0] > max(IN_TURN_TIMES * near, SMALLEST * smallest_step(x) * 0.1, IN_TURN_SPAN * float(np.ptp(x)))
    return bool(np.mean(far) > IN_TURN)
