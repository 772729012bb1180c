"""Figures of a diagnosis: error bars, signatures, traces, the heat map of separability, shifts of parameters."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from daq import FloatArray
from estimator import TWO_SIDED
from estimator.diagnosis import SensorGain, Signature, Trace
from experiments.documents import Share, finite
from experiments.reports.chart import Chart, Line
from experiments.reports.figures import (
    BLUE,
    GREEN,
    GREY,
    HEIGHT_IN,
    INK,
    ORANGE,
    ROW_IN,
    axis_label,
    blank_figure,
    draw,
    finish,
    name_rows,
    to_svg,
    window,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.container import BarContainer

ERRORS = "rms error, in multiples of what noise alone leaves"
"""Label of the axis of `paint_gains`."""

TRACE_SECONDS = 12.0
CROWDED = 0.15
"""Share of the range within which half of all bins must lie for an axis to be scaled about zero."""
Limits = tuple[float, float]


def error_bars(sensors: Mapping[str, SensorGain]) -> str:
    """Free-run error of each sensor in multiples of its own floor: nominal, extended, noise alone."""
    def paint(axes: Axes) -> None:
        for bars, values in paint_gains(axes, sensors):
            labels = ["diverged" if np.isinf(value) else f"{value:.2g}" for value in values]
            axes.bar_label(bars, labels, padding=3, fontsize=9.0)
        axes.margins(x=0.12)
        finish(axes, 3, ERRORS, "")

    return draw("errors", 0.9 + 0.75 * len(sensors), paint)


def paint_gains(axes: Axes, sensors: Mapping[str, SensorGain]) -> list[tuple[BarContainer, list[float]]]:
    """The bars of all sensors and their errors, of the nominal model, the extended one and noise alone."""
    out = []
    floor = np.array([max(gain.floor, 1e-300) for gain in sensors.values()])
    for k, (label, colour, which) in enumerate(
            (("nominal", BLUE, "before"), ("extended", ORANGE, "after"), ("noise alone", GREY, "floor"))):
        values = [getattr(gain, which) for gain in sensors.values()]
        share = np.array(values) / floor
        share[np.isinf(share)] = np.nan  # the simulation diverges: no bar
        out.append((axes.barh(np.arange(len(sensors)) + 0.27 * (k - 1), share, 0.25, color=colour, label=label,
                              zorder=2), values))
    name_rows(axes, list(sensors))
    return out


def waterfall(budget: Sequence[Share]) -> str:
    """Bars from the nominal model's error to noise alone: each part where the one above it ends, with its interval."""
    names = {"nominal": "nominal model", "remainder": "residual", "noise": "noise alone"}
    colours = {"nominal": BLUE, "cause": GREEN, "remainder": ORANGE, "noise": GREY}

    def paint(axes: Axes) -> None:
        top = 1.0
        for k, row in enumerate(budget):
            share = finite(row.of_error)
            begin = 0.0 if row.what == "nominal" else top - share
            axes.barh(k, 100.0 * share, 0.6, left=100.0 * begin, color=colours[row.what], zorder=2)
            right = begin + share
            if row.what != "nominal":
                low, high = (right - finite(c) for c in row.of_error_ci95)
                axes.plot([100.0 * low, 100.0 * high], [k, k], color=INK, linewidth=1.5, zorder=3)
                right, top = max(right, low, high), begin
            axes.annotate(f"{100 * share:.1f} %", (100.0 * right, k), xytext=(5, 0), fontsize=9.0, va="center",
                          textcoords="offset points")
        name_rows(axes, [names.get(r.what) or (r.effect or "").replace("_", " ") +
                         (f" at joint {r.joint}" if r.joint else "") for r in budget])
        axes.margins(x=0.14)
        axes.set_xlim(left=0.0)
        axes.set_xlabel("mean squared error [%]")

    return draw("budget", 0.9 + 0.5 * len(budget), paint)


def signature_limits(signatures: Sequence[Signature]) -> dict[tuple[str, str], tuple[Limits, Limits]]:
    """(x label, y label) -> limits that hold all signatures with these axes, so that they can be compared."""
    alike = defaultdict[tuple[str, str], list[Signature]](list)
    for s in signatures:
        alike[s.x_label, s.y_label].append(s)
    return {key: (_limits(s.x for s in own), _limits(
        values for s in own for values in (s.before - s.before_error, s.before + s.before_error, s.curve, s.after)))
        for key, own in alike.items()}


def _limits(curves: Iterable[FloatArray]) -> Limits:
    """Smallest and largest value of all."""
    every = np.concatenate([*curves])
    return float(every.min()), float(every.max())


def signature_plot(s: Signature, limits: tuple[Limits, Limits]) -> str:
    """Residuals of the nominal and the extended model over the effect's natural variable, and the effect's curve."""
    def paint(axes: Axes) -> None:
        axes.axhline(0.0, color=INK, linewidth=0.6)
        axes.errorbar(s.x, s.before, s.before_error, fmt="o", color=BLUE, markersize=4.0, linewidth=1.0,
                      label="nominal leaves", zorder=3)
        axes.plot(s.x, s.curve, color=ORANGE, linewidth=1.6, label="effect", zorder=4)
        axes.plot(s.x, s.after, "s", color=GREEN, markersize=3.5, label="extended leaves", zorder=2)
        # Bins hold equally many samples: where they crowd about zero, that is where the effect lives.
        middle = float(np.median(np.abs(s.x)))
        if 0.0 < middle < CROWDED * float(np.max(np.abs(s.x))) and s.x.min() < 0.0 < s.x.max():
            axes.set_xscale("symlog", linthresh=middle)
        axes.set_xlim(*_widened(limits[0]))
        axes.set_ylim(*_widened(limits[1]))
        finish(axes, 3, s.x_label, s.y_label)

    return draw(f"signature {s.title}", HEIGHT_IN + 0.4, paint)


def _widened(limits: Limits) -> Limits:
    margin = 0.05 * max(limits[1] - limits[0], 1e-12)
    return limits[0] - margin, limits[1] + margin


def trace_plot(trace: Trace, column: str) -> str:
    """First seconds of one confirm run: measured and simulated before and after; below it the two errors."""
    part = window(trace.time_s, TRACE_SECONDS)
    time_s = trace.time_s[part] - trace.time_s[0]
    measured, before, after = (trace_of[column][part] for trace_of in (trace.measured, trace.before, trace.after))
    with blank_figure(f"trace {column}", 1.6 * HEIGHT_IN) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        upper.plot(time_s, measured, color=BLUE, linewidth=2.4, label="measured")
        for values, label, colour in ((before, "nominal", GREEN), (after, "extended", ORANGE)):
            upper.plot(time_s, values, color=colour, linewidth=1.0, label=label)
            lower.plot(time_s, values - measured, color=colour, linewidth=1.0)
        lower.axhline(0.0, color=INK, linewidth=0.6)
        finish(upper, 3, "", axis_label(column))
        lower.set_xlabel("time [s]")
        lower.set_ylabel(f"error {axis_label(column).partition(' ')[2]}")
        lower.set_xlim(float(time_s[0]), float(time_s[-1]))
        return to_svg(figure)


def trace_chart(trace: Trace, column: str) -> Chart:
    """The whole run for a browser: measured, simulated before and after, and both errors."""
    measured, before, after = (of[column] for of in (trace.measured, trace.before, trace.after))
    return Chart(trace.time_s - trace.time_s[0], [
        Line("measured", measured, BLUE, 2.4), Line("nominal", before, GREEN), Line("extended", after, ORANGE),
        Line("nominal less measured", before - measured, GREEN, 1.0, below=True),
        Line("extended less measured", after - measured, ORANGE, 1.0, below=True)], axis_label(column),
        below=f"error of {axis_label(column)}")


def heat_map(labels: Sequence[str], cosines: FloatArray) -> str:
    """Cosines (k, k), lower triangle, as tinted cells with their numbers; rows are named, columns numbered."""
    from matplotlib.colors import to_rgba

    k = len(labels)

    def paint(axes: Axes) -> None:
        for i in range(k):
            for j in range(i):
                value = float(cosines[i, j])
                colour = (*to_rgba(ORANGE if value > 0 else BLUE)[:3], min(abs(value), 1.0))
                axes.fill([j, j + 1, j + 1, j], [i, i, i + 1, i + 1], color=colour, linewidth=0.0)
                if abs(value) >= 0.05:
                    axes.text(j + 0.5, i + 0.5, f"{value:.1f}".replace("0.", "."), ha="center", va="center",
                              fontsize=7.0)
        axes.set_xlim(0, max(k - 1, 1))
        axes.set_ylim(k, 1)
        axes.set_xticks(np.arange(k - 1) + 0.5, [str(j + 1) for j in range(k - 1)], fontsize=8.5)
        axes.set_yticks(np.arange(1, k) + 0.5, [f"{label} ({i + 2})" for i, label in enumerate(labels[1:])],
                        fontsize=8.5)
        axes.tick_params(length=0)
        axes.grid(visible=False)
        axes.spines[:].set_visible(False)
        axes.set_title(f"{labels[0]} (1)", loc="left", fontsize=8.5)

    return draw("separability", 0.8 + 0.26 * k, paint)


def shift_plot(nominal: Mapping[str, tuple[float, float]], extended: Mapping[str, tuple[float, float]]) -> str:
    """Extended against nominal parameters, (value, std) by name, in standard deviations of the nominal ones."""
    names = [n for n in nominal if n in extended and 0.0 < nominal[n][1] < np.inf and extended[n][1] < np.inf]

    def paint(axes: Axes) -> None:
        rows = np.arange(len(names), dtype=float)
        unit = np.array([nominal[n][1] for n in names])
        shift = np.array([extended[n][0] - nominal[n][0] for n in names]) / unit
        spread = np.array([extended[n][1] for n in names]) / unit
        axes.axvline(0.0, color=INK, linewidth=0.6)
        axes.errorbar(np.zeros(len(names)), rows - 0.14, xerr=TWO_SIDED, fmt="o", color=BLUE, markersize=4.0,
                      label="nominal")
        axes.errorbar(shift, rows + 0.14, xerr=TWO_SIDED * spread, fmt="s", color=ORANGE, markersize=4.0,
                      label="extended")
        axes.set_yticks(rows, names)
        axes.invert_yaxis()
        finish(axes, 2, "shift [standard deviations of the nominal]; bars: 95 %", "")

    return draw("shifts", 1.0 + ROW_IN * len(names), paint)

