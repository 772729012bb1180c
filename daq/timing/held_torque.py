"""The torque between samples of an instantaneous current, from the commands that the drive followed.

A drive holds each command until the next one. A torque that is sampled at instants therefore has steps between its
samples, and a straight line through the samples misplaces each step by up to a sample period. Polls and commands share
one clock, so this error has the same sign for many steps and does not average out.

Model: tau(t) = g f(t) + r(t). f is the commanded staircase, delayed by d and passed through a first-order lag of time
constant T. r is what the samples have besides: slow errors of the drive, and noise. d, T and g minimise the sum of the
squared differences of successive residuals.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from daq.dataset import FloatArray
from daq.timing.resample import HOLE_PERIODS, TimedColumns

FINE = 8
"""Cells in a sample period."""
DELAYS_S, LAGS_S = np.arange(0.0, 0.0101, 0.001), (0.0, 0.001, 0.002, 0.004, 0.008)
"""Where the search begins; each halving of its steps then looks at the neighbours."""
HALVINGS = 5
SEARCHED_S = 20.0
"""Length of the part of the run that the search uses, from the first torque on [s]."""
FEWEST = 50
CHANCE = 20.0
"""Share of the differences' sum of squares that the commands must explain, times the number of samples. Delay and lag
that are searched for in noise reach a few."""
SPARSE = 1.01
"""Sample period, in steps of the grid, above which steps have no sample of their own: r is interpolated then."""


class Response(NamedTuple):
    """Response of the torque to its command."""

    delay_s: float
    lag_s: float
    gain: float
    explained: float
    """Share of the sum of squares of successive differences."""


def commanded_torque(time_s: FloatArray, sent_s: FloatArray, sent_nm: FloatArray, delay_s: float,
                     lag_s: float) -> tuple[FloatArray, FloatArray]:
    """f [N m] and its integral [N m s] at `time_s`: the staircase of commands after delay and first-order lag.

    f' = (u - f) / T, so the integral of f is that of the staircase u less T (f - f(start)).
    """
    knots = np.concatenate(([min(time_s[0], sent_s[0] + delay_s) - 1.0], sent_s + delay_s))
    held = np.concatenate(([0.0], sent_nm))
    area = np.concatenate(([0.0], np.cumsum(held[:-1] * np.diff(knots))))
    at = np.searchsorted(knots, time_s, side="right") - 1
    since = time_s - knots[at]
    staircase = area[at] + held[at] * since
    if lag_s <= 0.0:
        return held[at], staircase
    start, value = [0.0], 0.0
    for target, decay in zip(held.tolist(), np.exp(-np.diff(knots) / lag_s).tolist()):
        value = target + (value - target) * decay
        start.append(value)
    torque: FloatArray = held[at] + (np.array(start)[at] - held[at]) * np.exp(-since / lag_s)
    return torque, staircase - lag_s * torque


def find_response(time_s: FloatArray, torque_nm: FloatArray, sent_s: FloatArray, sent_nm: FloatArray) -> Response:
    """Delay, lag and gain that explain most of the differences of successive samples."""
    differences = np.diff(torque_nm)
    whole = float(differences @ differences)

    def tried(delay_s: float, lag_s: float) -> Response:
        asked = np.diff(commanded_torque(time_s, sent_s, sent_nm, delay_s, lag_s)[0])
        power, common = float(asked @ asked), float(asked @ differences)
        if not power or not whole:
            return Response(delay_s, lag_s, 0.0, 0.0)
        return Response(delay_s, lag_s, common / power, common**2 / power / whole)

    best = max((tried(delay, lag) for delay, lag in product(DELAYS_S.tolist(), LAGS_S)), key=lambda r: r.explained)
    step = 0.5e-3
    for _ in range(HALVINGS):
        near = product((-step, 0.0, step), repeat=2)
        best = max((tried(max(best.delay_s + a, 0.0), max(best.lag_s + b, 0.0)) for a, b in near),
                   key=lambda r: r.explained)
        step *= 0.5
    return best


class HeldTorque(NamedTuple):
    """A sampled torque, split into what the commands explain and the residual of each sample."""

    commanded: TimedColumns
    """`tau2_nm` = g f [N m], as means over cells of an eighth of the sample period, centred on their times."""
    time_s: FloatArray
    """(n,) times of the samples [s]."""
    residual_nm: FloatArray
    """(n,) samples less g f [N m]."""

    def residual_on(self, grid: FloatArray, step_s: float) -> FloatArray:
        """r [N m] at the grid's times: the mean of the samples of each step.

        Each sample counts in one step only, so that white noise of the samples stays white on the grid. A straight line
        between samples would correlate neighbours, which a fit takes for a torque that moves the joint. The edges of
        the steps are moved by less than half a sample period, to where no sample is near.
        """
        period = float(np.median(np.diff(self.time_s)))
        if period > SPARSE * step_s:
            return np.interp(grid, self.time_s, self.residual_nm)
        turns = np.exp(2j * np.pi * (self.time_s - grid[0] + 0.5 * step_s) / period)
        phase = float(np.angle(np.mean(turns))) / (2.0 * np.pi) % 1.0 - 0.5
        step = np.floor((self.time_s - grid[0] - phase * period) / step_s + 0.5).astype(int)
        inside = (step >= 0) & (step < grid.size)
        count = np.bincount(step[inside], minlength=grid.size)
        total = np.bincount(step[inside], self.residual_nm[inside], minlength=grid.size)
        own = np.flatnonzero(count)
        return np.interp(grid, grid[own], total[own] / count[own])


def split_torque(samples: TimedColumns, sent_s: FloatArray, sent_nm: FloatArray) -> HeldTorque | None:
    """The split of `tau2_nm`. None where the commands explain no more of it than chance: too few, or not followed.

    A gap of the samples is a gap of the commanded part.
    """
    torque = samples.columns["tau2_nm"]
    finite, good = np.isfinite(torque), np.isfinite(sent_nm)
    time_s, torque, sent_s, sent_nm = samples.time_s[finite], torque[finite], sent_s[good], sent_nm[good]
    moves = np.flatnonzero(sent_nm)
    if time_s.size < FEWEST or not moves.size:
        return None
    begin = float(sent_s[moves[0]])
    used = (time_s >= begin) & (time_s <= begin + SEARCHED_S)
    few = sent_s <= begin + SEARCHED_S
    if np.count_nonzero(used) < FEWEST:
        return None
    found = find_response(time_s[used], torque[used], sent_s[few], sent_nm[few])
    if found.explained < CHANCE / np.count_nonzero(used):
        return None
    period = float(np.median(np.diff(time_s)))
    edges = time_s[0] + np.arange(int((time_s[-1] - time_s[0]) / period * FINE) + 1) * (period / FINE)
    asked = commanded_torque(time_s, sent_s, sent_nm, found.delay_s, found.lag_s)[0]
    area = commanded_torque(edges, sent_s, sent_nm, found.delay_s, found.lag_s)[1]
    centres = 0.5 * (edges[1:] + edges[:-1])
    means = found.gain * np.diff(area) / np.diff(edges)
    after = np.clip(np.searchsorted(time_s, centres), 1, time_s.size - 1)
    means[time_s[after] - time_s[after - 1] > HOLE_PERIODS * period] = np.nan
    return HeldTorque(TimedColumns(centres, {"tau2_nm": means}), time_s, torque - found.gain * asked)
