"""Resampling from the samples' own times to a uniform grid, all channels through the same filter.

Two cases, chosen once for all channels of a run so that none is filtered or delayed against another:

- every channel is sampled at about the grid's rate or below: cubic splines through the samples, no filter;
- some channel is sampled at 1.5 times the grid's rate or above: every channel, angles included, becomes its
  mean over the centred window [t - dt/2, t + dt/2]. The window is symmetric, so there is no delay, and one
  linear filter on all channels leaves every linear relation between them as it was. Channels sampled fast
  are integrated exactly as straight lines between samples, slower ones as their cubic spline.

A hole longer than 2.5 nominal sample periods, and than a step of the grid, stays NaN: nothing is invented across it. A
pause of a fast logger that is shorter than the grid's step hides nothing that the grid could show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from daq.dataset import BoolArray, Dataset, FloatArray
from daq.errors import InputError
from daq.findings import Flag, ReadingFault
from daq.looks import look
from daq.runs import CLOCK_BOUND, RawTable

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline, PchipInterpolator

HOLE_PERIODS = 2.5
HOLE_STEPS = 1.0
OVERSAMPLED = 1.5
_MOST_EMPTY, _ALWAYS_FINE = 50, 1_000_000
"""A grid of so many times the samples is a mistake in the times, unless it is small anyway."""
_SPARSE = 25.0
"""Steps of the grid between samples, most: a grid of 100 Hz makes nothing of samples at 4 Hz, and of 1 kHz in
milliseconds taken for seconds."""
_SNAP_JITTER = 0.01
"""Largest departure from a uniform grid, in steps, at which samples count as lying on it."""
_SNAP_RATE = 1e-4
"""Largest relative error of the rate at which a grid counts as the nominal one (an oscillator's 100 ppm)."""


class TimedColumns(NamedTuple):
    """Samples that share their times."""

    time_s: FloatArray
    """(n,) strictly increasing [s]."""
    columns: Mapping[str, FloatArray]
    """(n,) each; a NaN is a sample that was not measured."""


def own_rate(channels: Sequence[TimedColumns]) -> float:
    """Rate of the slowest of the channels, to three digits [Hz]: on a grid of it nothing is interpolated in between."""
    return float(f"{min(_rate(channel.time_s) for channel in channels):.3g}")


def align_table(table: RawTable, rate_hz: float | None = None, as_read: bool = False) -> Dataset:
    """`table` on a uniform grid of `rate_hz`, by default, and where that is much finer, of its own rate.

    Samples that lie on such a grid already (within 1 % of a step) are taken as they are. Raises `InputError` where
    they come too seldom for it.
    """
    columns = {name: values for name, values in table.columns.items() if name != CLOCK_BOUND}
    found, text = _rate(table.time_s), ""
    step_s = 1.0 / max(found, 1e-12)
    if rate_hz is not None and step_s * rate_hz > _SPARSE:
        raise InputError(table.name, f"has a sample every {step_s:.3g} s, the grid is of {rate_hz:g} Hz",
                         'check that time_s is in seconds (unit = "ms" under [columns.time_s]), or lower rate_hz under '
                         "[sampling]")
    if rate_hz is not None and step_s * rate_hz > OVERSAMPLED:
        text = (f"has {found:.3g} samples a second, fewer than rate_hz = {rate_hz:g}: nothing is interpolated, its own "
                "grid is used; take rate_hz out of [sampling]")
    if rate_hz is None or text:
        rate_hz = own_rate([TimedColumns(table.time_s, columns)])
    run = align_channels(table.name, [TimedColumns(snapped_times(table.time_s, rate_hz), columns)], rate_hz,
                         as_read)
    if step_s * rate_hz * OVERSAMPLED <= 1.0:
        text = (f"has {found:.3g} samples a second, the grid {rate_hz:g}: they are averaged, and what moves faster is "
                "lost; take rate_hz out of [sampling] to use all")
        run = replace(run, averaged=found / rate_hz)
    run = replace(run, flags=(*table.flags, *run.flags, *([Flag("grid", text)] if text else [])))
    bound = table.columns.get(CLOCK_BOUND)
    return run if bound is None else replace(run, clock_bound_s=float(np.max(bound)))


def align_channels(name: str, channels: list[TimedColumns], rate_hz: float, as_read: bool = False) -> Dataset:
    """Channels, each at its own times, on one grid over the time that all of them cover.

    Each column is looked at before (`daq.looks`, which takes `as_read`), so that no filter spreads a wrong reading.
    Raises `InputError` when the times span so much that the grid would be empty nearly everywhere, and as `look`.
    """
    channels = [channel for channel in channels if channel.time_s.size]
    averaged = any(_rate(channel.time_s) >= OVERSAMPLED * rate_hz for channel in channels)
    margin = 0.5 / rate_hz if averaged else 0.0
    start = max(float(channel.time_s[0]) for channel in channels) + margin
    stop = min(float(channel.time_s[-1]) for channel in channels) - margin
    count = max(int(np.floor((stop - start) * rate_hz + 1e-6)) + 1, 0)
    samples = max(channel.time_s.size for channel in channels)
    if count > max(_MOST_EMPTY * samples, _ALWAYS_FINE):
        raise InputError(name, f"spans {stop - start:.6g} s with {samples} samples, too few for {rate_hz:g} Hz",
                         "check that time_s is in seconds and that no time is far off")
    grid = start + np.arange(count) / rate_hz
    columns: dict[str, FloatArray] = {}
    faults: list[ReadingFault] = []
    for channel in channels:
        seen = look(channel.time_s, channel.columns, name, as_read)
        faults += seen.faults
        for column, values in seen.columns.items():
            columns[column] = _on_grid(channel.time_s, values, grid, rate_hz, averaged)
            if column in seen.left_out:
                columns[column][reached(grid, channel.time_s, seen.left_out[column], margin)] = np.nan
    return Dataset(name, rate_hz, grid, columns, readings=tuple(faults))


def reached(grid: FloatArray, time_s: FloatArray, left_out: BoolArray, half: float) -> BoolArray:
    """(g,) points of the grid that use a reading of `left_out` (n,): those between the good readings around it, with
    windows that reach `half` [s] to both sides."""
    edges = np.diff(np.concatenate(([False], left_out, [False])).astype(np.int8))
    first, stop = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    padded = np.concatenate(([-np.inf], time_s, [np.inf]))
    slack = 1e-9 + (0.0 if not half else -half)
    out = np.zeros(grid.size, bool)
    for after, before in zip(padded[first], padded[stop + 1]):
        out[np.searchsorted(grid, after + slack, side="right"):np.searchsorted(grid, before - slack)] = True
    return out


def snapped_times(time_s: FloatArray, rate_hz: float) -> FloatArray:
    """`time_s` made exactly uniform where it is so within a hundredth of a step, otherwise as given.

    The rate may be off by 100 ppm, as an oscillator is: time is then scaled by that, nothing is filtered.
    """
    steps = np.diff(time_s)
    index = np.concatenate(([0.0], np.cumsum(np.rint(steps / np.median(steps)))))
    if not (np.diff(index) > 0).all():
        return time_s
    period, start = np.polynomial.Polynomial.fit(index, time_s, 1).convert().coef[::-1]
    uniform = np.abs(time_s - start - period * index).max() <= _SNAP_JITTER * period
    if not uniform or abs(period * rate_hz - 1.0) > _SNAP_RATE:
        return time_s
    return time_s[0] + index / rate_hz


def _rate(time_s: FloatArray) -> float:
    return 1.0 / float(np.median(np.diff(time_s))) if time_s.size > 1 else 0.0


def _on_grid(time_s: FloatArray, values: FloatArray, grid: FloatArray, rate_hz: float, averaged: bool) -> FloatArray:
    """One column on the grid; NaN where the samples around a grid time (or its window) have a hole."""
    out = np.full(grid.shape, np.nan)
    finite = np.isfinite(values)
    time_s, values = time_s[finite], values[finite]
    hole = max(HOLE_PERIODS / max(_rate(time_s), 1e-12), HOLE_STEPS / rate_hz)
    if time_s.size == 0:
        return out
    half = 0.5 / rate_hz if averaged else 0.0
    linear = _rate(time_s) >= OVERSAMPLED * rate_hz
    slack = 1e-9 / rate_hz
    breaks = np.flatnonzero(np.diff(time_s) > hole) + 1
    for a, b in zip(np.concatenate(([0], breaks)), np.concatenate((breaks, [time_s.size]))):
        t, y = time_s[a:b], values[a:b]
        first = int(np.searchsorted(grid, t[0] + half - slack))
        last = int(np.searchsorted(grid, t[-1] - half + slack, side="right"))
        where = slice(first, last)
        if last <= first:
            continue
        if not averaged and np.array_equal(t, grid[where]):
            out[where] = y
        elif not averaged:
            out[where] = _cubic(t, y)(grid[where]) if t.size > 1 else y[0]
        elif linear:
            out[where] = _linear_mean(t, y, grid[where], half)
        else:
            out[where] = _cubic_mean(t, y, grid[where], half)
    return out


def _cubic(t: FloatArray, y: FloatArray) -> CubicSpline | PchipInterpolator:
    from scipy.interpolate import CubicSpline, PchipInterpolator

    # A natural choice is the spline; where two samples almost coincide it would turn their noise into
    # a large slope and ring, and the monotone cubic does not.
    steps = np.diff(t)
    if t.size < 4 or steps.min() < 0.2 * np.median(steps):
        return PchipInterpolator(t, y)
    return CubicSpline(t, y)


def _cubic_mean(t: FloatArray, y: FloatArray, grid: FloatArray, half: float) -> FloatArray:
    if t.size < 2:
        return np.full(grid.shape, np.nan)
    integral = _cubic(t, y).antiderivative()
    return (integral(grid + half) - integral(grid - half)) / (2.0 * half)


def _linear_mean(t: FloatArray, y: FloatArray, grid: FloatArray, half: float) -> FloatArray:
    """Mean over [g - half, g + half] of straight lines between samples, exact."""
    # Deviations from the mean keep the running integral small, so that its differences stay exact.
    centre = y.mean()
    y = y - centre
    running = np.concatenate(([0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t))))

    def integral(x: FloatArray) -> FloatArray:
        i = np.clip(np.searchsorted(t, x, side="right") - 1, 0, t.size - 2)
        u = x - t[i]
        slope = (y[i + 1] - y[i]) / (t[i + 1] - t[i])
        return running[i] + u * (y[i] + 0.5 * slope * u)

    return centre + (integral(grid + half) - integral(grid - half)) / (2.0 * half)
