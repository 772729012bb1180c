"""Two models side by side as sections of a page: `legid compare --html`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from daq import Dataset
from estimator.prediction import PredictionTable
from experiments.documents import ComparisonDocument, ErrorPair
from experiments.judge import horizon_text
from experiments.provenance import origin_of
from experiments.reports.chart import Line
from experiments.reports.comparison import ERROR_HEADER, PARAMETER_HEADER, error_rows, parameter_rows
from experiments.reports.diagnosis_figures import axis_label, draw
from experiments.reports.figures import BLUE, GREEN, GREY, HEIGHT_IN, INK, ORANGE, finish, picture_lines
from experiments.reports.html import Picture, Section, Table, fold, trust_box, write_page
from experiments.reports.origin import origin_section

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIGURE_SECONDS = 12.0


def write_comparison(path: Path | str, found: ComparisonDocument, table: PredictionTable, model: str,
                     runs: Sequence[Dataset]) -> None:
    """Write the page of a comparison on `runs` of a mechanism called `model`, whose free runs are in `table`. Raises
    `InputError` where that place cannot be written."""
    origin = found.provenance or origin_of()
    write_page(path, f"{found.models[0]} (A) against {found.models[1]} (B)",
               f"Two models of {model} on {len(runs)} run{'s' * (len(runs) != 1)}.",
               [*comparison_sections(found, table), origin_section(origin, runs)], origin, trust_box(found.trust))


def comparison_sections(found: ComparisonDocument, table: PredictionTable) -> list[Section]:
    """Errors, figures of the first run, parameters, all folded; the ratio of the errors leads the page."""
    return fold([
        Section("Free-run errors over horizons",
                [f"A is {found.models[0]}, B is {found.models[1]}. Each piece starts in the state that the model "
                 "estimates there from all sensors, and is then driven by the measured torque alone. The error is "
                 "simulated less measured reading. The interval of the ratio comes from its scatter between runs, or "
                 "between pieces of 2 s if there are few runs. B is better if the interval lies below 1, A if it lies "
                 "above."],
                [Table(ERROR_HEADER, error_rows(found), right=frozenset({2, 3, 4, 5}))],
                [Picture(ratio_plot(found.errors), "Rms error of B over that of A with 95 % intervals: below 1, B is "
                         "better.", leads=True)]),
        *_traces(table),
        Section("Parameters", ["z is the difference over its standard deviation, as if the two were independent. "
                               "Beyond +-2 they differ. If both were fitted to the same runs, z is too small."],
                [Table(PARAMETER_HEADER, parameter_rows(found), right=frozenset({1, 2, 3, 4, 5}))])])


def _traces(table: PredictionTable) -> list[Section]:
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
    title = f"Free run of {first.run}"
    return [Section(title, ["Whole segments, each from its first state."], (), pictures)] if pictures else []


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
