"""Jumps of an angle that no joint makes: wraps, readings that are off and come back, steps, two senders in turn."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from daq.dataset import BoolArray, FloatArray, IndexArray

TURNS = tuple(2.0 * np.pi / k for k in (1, 2, 3, 4))
"""Ranges over which an angle in rad is wrapped: nothing is unwrapped by another."""
NEAR_TURN, MOST_UNSURE = 0.01, 0.05
"""A wrap is as large as its range to the first share, and to the changes of the steps next to it, of which the second
share counts at most: a potentiometer passes its dead band in several samples."""
MOST_OTHERS = 2
"""Large jumps in addition to the wraps, at most, or as many as there are wraps."""
SPAN_SHARE = 0.7
"""A wrap moves the reading by more than this share of the column's range."""
EDGE_STEPS, EDGE_SHARE, MOST_EDGE = 2.5, 0.02, 0.3
"""A wrap leads from one end of the range to the other: within so many of the column's fastest steps and the first share
of the range, which together are at most the second share: a column of noise wraps nowhere."""
AROUND_WRAP, ONWARD = 10, 0.9
"""Samples on both sides of a wrap in which the joint moves on. Wraps where it clearly moves are against its motion in
more than this share; a servo that goes from one end to the other moves with the jump, or not at all."""
LONGEST_WRONG_WRAP, LONGEST_ISOLATED = 3, 50
"""Readings that are off in one place, at most."""
RATE_SHARE = 97.0
"""Percentile of the steps of a moving column that is its usual fastest one."""
FASTEST, CHANGES, SMALLEST, NEIGHBOURS = 1.5, 12.0, 20.0, 4.0
"""A jump is none of a joint if it exceeds so many times the fastest step, the usual change of steps, the resolution,
and the changes of its neighbours. (An impact that reverses the speed moves a reading by one fastest step at most.)"""
MOVING, LEAST_MOVING = 5.0, 20
"""A column moves where its step exceeds so many times its resolution; what moves in fewer samples gives no scale."""
MOST_ACCELERATION = 3e3
"""No joint accelerates by more from one sample to the next [rad/s2, m/s2]: from rest to rest over s within a period T
takes 4 s / T^2."""
HELD_ROWS = 4
"""Equal readings next to a jump, at least, that were a frozen sensor."""
NEAR_LAGS, IN_TURN, IN_TURN_TIMES = 4, 0.1, 10.0
"""Two series take turns where in more than this share of the samples the last reading is far, and one of the three
before so many times nearer."""
IN_TURN_SPAN = 0.05


class Jumps(NamedTuple):
    """Places at which a column jumps."""

    isolated: list[tuple[int, int]]
    """[start, stop) of readings that are off, with good ones on both sides."""
    frozen: list[tuple[int, int]]
    """[start, stop) of equal readings next to a jump."""
    steps: list[tuple[int, float]]
    """First sample behind a step that does not return, and its size."""


class Scale(NamedTuple):
    """Resolution and usual changes of a column."""

    resolution: float
    """The step of its values, or its noise where that is larger"""
    fast: float
    """Usual fastest step where it moves; 0 where it hardly does"""
    change: float
    """Usual largest change of its steps there"""


def scale_of(x: FloatArray) -> Scale:
    """Scale of x (n,), taken where the column moves: neither rest nor one large motion changes it."""
    steps = np.abs(np.diff(x))
    changes = np.abs(np.diff(x, 2))
    values = np.unique(x)
    step = float(np.percentile(np.diff(values), 5.0)) if values.size > 1 else 0.0
    resolution = max(step, float(np.percentile(changes, 25.0)) if changes.size else 0.0)
    moving = steps > MOVING * resolution
    if np.count_nonzero(moving) < LEAST_MOVING:
        return Scale(resolution, 0.0, 0.0)
    among = changes[moving[1:] | moving[:-1]]
    return Scale(resolution, float(np.percentile(steps[moving], RATE_SHARE)), float(np.percentile(among, 95.0)))


def unwrapped(x: FloatArray) -> tuple[FloatArray, float, IndexArray] | None:
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
    smooth = np.where(big, 0.0, steps)
    scale = scale_of(np.cumsum(smooth))
    usual, at = max(scale.fast, scale.resolution), np.flatnonzero(big)
    before, behind = smooth[np.maximum(at - 1, 0)], smooth[np.minimum(at + 1, steps.size - 1)]
    jumps, unsure = steps[at] - 0.5 * (before + behind), NEIGHBOURS * (np.abs(behind - before) + scale.resolution)
    for modulus in TURNS:
        off = CHANGES * max(scale.change, scale.resolution) + NEAR_TURN * modulus
        limits = _Limits(modulus, EDGE_STEPS * usual + EDGE_SHARE * modulus, off, ends)
        if limits.slack > MOST_EDGE * modulus or ends[1] - ends[0] > modulus + limits.slack:
            continue
        fits = np.array([limits.wraps(jump, x[k], x[k + 1]) for k, jump in zip(at.tolist(), jumps)], bool)
        fits &= np.abs(np.abs(jumps) - modulus) < NEAR_TURN * modulus + np.minimum(unsure, MOST_UNSURE * modulus)
        count = int(fits.sum())
        few = at.size - count > max(count, MOST_OTHERS) or not _moves_on(smooth, at[fits], np.sign(jumps[fits]),
                                                                         scale.resolution)
        turned = np.zeros(x.size)
        if not few:
            turned[at[fits] + 1] = np.sign(jumps[fits])
        out, over = _over_isolated(x - modulus * np.cumsum(turned), x, limits, usual)
        if not few or over:
            return out, modulus, np.sort(np.concatenate([np.flatnonzero(turned), np.array(over, dtype=np.intp)]))
    return None


def _moves_on(smooth: FloatArray, at: IndexArray, way: FloatArray, resolution: float) -> bool:
    """Whether the joint moves through the jumps `at` steps (m,), against their `way`; `smooth` (n - 1,) are the steps
    without large jumps."""
    path = np.concatenate(([0.0], np.cumsum(smooth)))
    before = path[at] - path[np.maximum(at - AROUND_WRAP, 0)]
    behind = path[np.minimum(at + 1 + AROUND_WRAP, path.size - 1)] - path[at + 1]
    clear = (before * behind > 0.0) & (np.minimum(np.abs(before), np.abs(behind)) > MOVING * resolution)
    return bool(clear.any() and np.mean(before[clear] * way[clear] < 0.0) > ONWARD)


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
    groups = np.split(far, np.flatnonzero(np.diff(far) > LONGEST_WRONG_WRAP) + 1) if far.size else []
    out, found = y.copy(), list[int]()
    for group in groups:
        last, behind = int(group[0]), int(group[-1]) + 1
        if not 2 <= behind - last <= LONGEST_WRONG_WRAP + 1 or last < 1 or behind > y.size - 2:
            continue
        own = 0.5 * (y[last] - y[last - 1] + y[behind + 1] - y[behind])
        jump = y[behind] - y[last] - own * (behind - last)
        if not limits.wraps(jump, x[last], x[behind]) or (
                abs(abs(jump) - limits.modulus) > 2.0 * NEAR_TURN * limits.modulus):
            continue
        out[behind:] -= np.sign(jump) * limits.modulus
        line = np.linspace(out[last], out[behind], behind - last + 1)[1:-1]
        between = out[last + 1:behind]
        out[last + 1:behind] = between + limits.modulus * np.rint((line - between) / limits.modulus)
        found.append(behind)
    return out, found


def find_jumps(x: FloatArray, apart: BoolArray, period_s: float) -> Jumps:
    """Wrong readings and steps of x (n,), sampled every `period_s`, that no motion makes.

    `apart` (n - 1,): pairs with a pause in between, which may jump. The rates on both sides of a jump go on as if it
    was not there, or it takes more than the acceleration that any joint has.
    """
    jumps = Jumps([], [], [])
    if x.size < 10:
        return jumps
    steps, scale = np.where(apart, 0.0, np.diff(x)), scale_of(x)
    least = max(FASTEST * scale.fast, CHANGES * max(scale.change, scale.resolution), SMALLEST * scale.resolution)
    suspects = np.flatnonzero(np.abs(np.diff(steps, prepend=0.0)) > 0.5 * least) + 1
    good = 0

    def moves_on(first: int, stop: int) -> bool:
        return min(abs(float(np.mean(side))) if side.size else 0.0 for side in (
            np.diff(x[max(first - 4, 0):first]), np.diff(x[stop:stop + 4]))) > MOVING * scale.resolution

    def too_fast(size: float) -> bool:
        return 4.0 * abs(size) > MOST_ACCELERATION * period_s**2

    for first in suspects.tolist():
        if first < good or abs(steps[first - 1]) <= 0.5 * least:
            continue
        for stop in suspects[(suspects > first) & (suspects <= min(first + LONGEST_ISOLATED, x.size - 2))].tolist():
            off = _off(x, first, stop, least)
            if off and (moves_on(first, stop) or too_fast(off)):
                jumps.isolated.append((first, stop))
                good = stop + 1
                break
        else:
            size = _step(x, first, least)
            start, stop = _held(x, first, -1), _held(x, first, 1)
            if size and start < stop and moves_on(start, stop):
                jumps.frozen.extend((a, b) for a, b in ((start, first), (first, stop)) if a < b)
                good = stop
            elif size and (moves_on(first, first) or too_fast(size)):
                jumps.steps.append((first, size))
    return jumps


def _off(x: FloatArray, first: int, stop: int, least: float) -> float:
    """How far both ends of the readings [first, stop) are off the line between their neighbours; 0 where the motion
    may lead there."""
    line = np.linspace(x[first - 1], x[stop], stop - first + 2)
    off = float(min(abs(x[first] - line[1]), abs(x[stop - 1] - line[-2])))
    rates = np.concatenate([np.diff(x[max(first - 3, 0):first]), np.diff(x[stop:stop + 3])])
    beyond = rates.size > 2 and off > NEIGHBOURS * float(np.max(np.abs(rates - (line[1] - line[0]))))
    return off if off > least and beyond else 0.0


def _step(x: FloatArray, first: int, least: float) -> float:
    """Size of a step between `first` - 1 and `first` beyond the motion of its neighbours; 0 where there is none."""
    before, behind = np.diff(x[max(first - 3, 0):first]), np.diff(x[first:first + 3])
    if before.size < 2 or behind.size < 2:
        return 0.0
    own = 0.5 * (before[-1] + behind[0])
    size = float(x[first] - x[first - 1] - own)
    changes = max(abs(before[1] - before[0]), abs(behind[1] - behind[0]), abs(behind[0] - before[-1]))
    return size if abs(size) > max(least, NEIGHBOURS * changes) else 0.0


def _held(x: FloatArray, first: int, way: int) -> int:
    """Where the equal readings in front of a jump at `first`, or behind it, begin to hang, or end; `first` where they
    are few."""
    at = end = first if way > 0 else first - 1
    while 0 < end < x.size - 1 and x[end + way] == x[at]:
        end += way
    return first if abs(end - at) < HELD_ROWS - 1 else end + 1


def take_turns(x: FloatArray) -> bool:
    """Whether two series take turns in x (n,): neighbours are far apart, readings a few samples before are near."""
    if x.size < 10 * NEAR_LAGS or np.ptp(x) == 0.0:
        return False
    last, *others = (np.abs(x[NEAR_LAGS:] - x[NEAR_LAGS - lag:x.size - lag]) for lag in range(1, NEAR_LAGS + 1))
    far = last > IN_TURN_SPAN * float(np.ptp(x))
    if np.mean(far) <= IN_TURN:
        return False
    near = max(float(np.median(np.min(others, axis=0)[far])), float(np.percentile(np.diff(np.unique(x)), 5.0)))
    return float(np.median(last[far])) > IN_TURN_TIMES * near
