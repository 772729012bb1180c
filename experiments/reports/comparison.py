"""Two models side by side, as text and page: `legid compare`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from estimator.prediction import PredictionTable
from experiments.documents import ComparisonDocument, ErrorPair, Value, finite
from experiments.judge import NAMES, Estimate, horizon_text, number
from experiments.reports.chart import Line
from experiments.reports.figures import (
    BLUE,
    GREEN,
    GREY,
    HEIGHT_IN,
    INK,
    ORANGE,
    axis_label,
    draw,
    finish,
    picture_lines,
)
from experiments.reports.html import Picture, Section, Table, fold
from experiments.reports.origin import write_result

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIGURE_SECONDS = 12.0


def parameter_table(document: ComparisonDocument) -> Table:
    """One row a parameter."""
    return Table(["parameter", "A", "95 % interval", "B", "95 % interval", "z of B - A", "unit", "meaning"], [
        [p.name, *_cells(p.a), *_cells(p.b), "" if p.z is None else f"{p.z:+.1f}", p.unit, p.meaning]
        for p in document.parameters], range(1, 6))


def _cells(side: Value | None) -> tuple[str, str]:
    if side is None:
        return "", ""
    low, high = map(finite, side.ci95)
    return number(side.value, finite(side.std)), Estimate(side.value, finite(side.std), low, high).interval


def horizon_errors_table(document: ComparisonDocument) -> Table:
    """One row a horizon and sensor."""
    def rms(value: float | None) -> str:
        return "diverged" if value is None else f"{value:.4g}"

    return Table(["horizon", "sensor", "rms error of A", "of B", "B / A", "95 % interval", "better"], [
        [horizon_text(e.length_s), e.column, rms(e.a), rms(e.b), "" if e.ratio is None else f"{e.ratio:.3f}",
         "" if e.ratio_ci95 is None else f"{e.ratio_ci95[0]:.3f} .. {e.ratio_ci95[1]:.3f}", e.better or ""]
        for e in document.errors], range(2, 6))


def comparison_text(found: ComparisonDocument) -> str:
    """Text after `legid compare`."""
    return "\n".join([found.headline.text, "", *(f"{name}: {file}" for name, file in zip(NAMES, found.models)), "",
                      parameter_table(found).text, "", f"Free runs of {', '.join(found.runs)}:",
                      horizon_errors_table(found).text])


def write_comparison(path: Path | str, document: ComparisonDocument, model: str = "a rig",
                     table: PredictionTable | None = None) -> None:
    """Write the page of a comparison of two models of a mechanism called `model`. Raises `InputError` where that place
    cannot be written."""
    count = len(document.runs)
    write_result(path, document, " against ".join(name if name == file else f"{file} ({name})"
                                                  for name, file in zip(NAMES, document.models)),
                 f"Two models of {model} on {count} run{'s' * (count != 1)}.", comparison_sections(document, table))


def comparison_sections(found: ComparisonDocument, table: PredictionTable | None) -> list[Section]:
    """Errors, parameters, and the first run where free runs are known, all folded; the ratio of the errors leads the
    page."""
    files = [] if found.models == NAMES else [f"A is {found.models[0]}, B is {found.models[1]}."]
    return fold(
        Section("Free-run errors over horizons",
                [" ".join([*files, "Each piece starts in the state that the model estimates there from all sensors. It "
                           "is then driven by the measured torque alone. The error is simulated less measured. "
                           "The interval of the ratio comes from its scatter between runs, or between pieces of 2 s if "
                           "there are few runs. B is better if the interval lies below 1, A if it lies above."])],
                [horizon_errors_table(found)],
                [Picture(ratio_plot(found.errors), "Rms error of B over that of A with 95 % intervals: below 1, B is "
                         "better.", leads=True)]),
        None if table is None else _traces(table),
        Section("Parameters", ["z is the difference over its standard deviation, as if the two were independent. "
                               "Beyond +-2 they differ. If both were fitted to the same runs, z is too small."],
                [parameter_table(found)]))


def _traces(table: PredictionTable) -> Section | None:
    """The first run by both models."""
    first = table.runs[0]
    pictures = []
    for column in table.judged:
        measured = first.measured[table.channels.index(column)]
        sides = [("A", first.trace(column, 0), GREEN), ("B", first.trace(column, 1), ORANGE)]
        known = [(name, values, colour) for name, values, colour in sides if np.isfinite(values).all()]
        pictures += [
            picture_lines(first.time_s, [Line("measured", measured, BLUE, 2.2),
                                         *(Line(name, values, colour) for name, values, colour in known)],
                          axis_label(column), f"{column}: measured, and simulated by both models.", FIGURE_SECONDS),
            picture_lines(first.time_s, [Line(f"{name} less measured", values - measured, colour)
                                         for name, values, colour in known],
                          f"error of {axis_label(column)}", f"{column}: the errors of both models.",
                          FIGURE_SECONDS)] if known else []
    return Section(f"Free run of {first.run}", ["Whole segments, each from its first state."], (), pictures
                   ) if pictures else None


def ratio_plot(errors: Sequence[ErrorPair]) -> str:
    """B / A with intervals by sensor and horizon."""
    shown = [e for e in errors if e.ratio is not None]
    horizons = list(dict.fromkeys(e.length_s for e in errors))
    columns = list(dict.fromkeys(e.column for e in errors))

    def paint(axes: Axes) -> None:
        axes.axhline(1.0, color=INK, linewidth=0.8)
        for k, (column, colour) in enumerate(zip(columns, (BLUE, ORANGE, GREEN, GREY) * len(columns))):
            some = [e for e in shown if e.column == column]
            x = np.array([horizons.index(e.length_s) for e in some]) + 0.12 * (k - (len(columns) - 1) / 2)
            y = np.array([e.ratio for e in some])
            low, high = np.array([e.ratio_ci95 or (r, r) for e, r in zip(some, y)]).reshape(-1, 2).T
            axes.errorbar(x, y, [np.maximum(y - low, 0.0), np.maximum(high - y, 0.0)], fmt="o", color=colour,
                          markersize=4.0, label=column)
        axes.set_yscale("log")
        axes.set_xticks(range(len(horizons)), [horizon_text(h) for h in horizons])
        finish(axes, len(columns), "horizon", "error of B / error of A")

    return draw("ratio", HEIGHT_IN + 0.4, paint)
