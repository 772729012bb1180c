"""The uncertainty budget of a fit: as a line, a table, and a bar for each parameter."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.documents import FitDocument, finite
from experiments.judge import LEAST_PART, PARTS_TOLD, number, sentence_of, source_words
from experiments.reports.figures import BLUE, GREEN, GREY, INK, ORANGE, ROW_IN, draw, finish, name_rows
from experiments.reports.html import Picture, Section, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BARS = 5
"""Sources with a colour of their own in a bar."""
COLOURS = (ORANGE, GREEN, INK, "#c9a227", "#8a5fb0")


def budget_table(fit: FitDocument) -> Table:
    """One row for each estimated parameter."""
    values, rows = {p.name: p for p in fit.parameters}, []
    for row in fit.budget or ():
        p = values[row.parameter]
        std = finite(p.std)
        if not std > 0.0:
            continue
        half = finite(row.half_width)
        alone = [(part.source, half / std * finite(part.std)) for part in row.parts]
        parts = [f"{source_words(source)} {number(part, std)}" for source, part in alone if part > LEAST_PART * half]
        rows.append([p.name, number(finite(p.value), std), number(half, std), ", ".join(parts[: PARTS_TOLD + 1])])
    return Table(["parameter", "value", "+- (95 %)", "largest parts, each alone"], rows, {1, 2})


def budget_lines(fit: FitDocument) -> list[str]:
    """Tolerances that the runs enlarge; none without any."""
    grown = ", ".join(f"{group} {factor:.2g} times" for group, factor in
                      sorted(fit.tolerances_enlarged.items(), key=lambda pair: -pair[1]))
    return [f"the runs ask for larger tolerances: {grown}"] if grown else []


def budget_section(fit: FitDocument) -> Section | None:
    """For the page: a bar for each parameter; None without a budget."""
    table = budget_table(fit)
    if not table.rows:
        return None
    text = ["Each bar is the variance of a parameter, as the sum of its parts. Noise and scatter between runs come "
            "from the runs. All else are tolerances, which rig.toml states under [tolerance], or which have a default.",
            *map(sentence_of, budget_lines(fit))]
    return Section("What the intervals consist of", text, [table],
                   [Picture(_bars(fit), "Share of each source in the variance of each parameter.")])


def _bars(fit: FitDocument) -> str:
    stds = {p.name: finite(p.std) for p in fit.parameters}
    shown = [row for row in fit.budget or () if stds[row.parameter] > 0.0]
    share = {part.source: np.array([next((finite(one.std) / stds[row.parameter] for one in row.parts
                                          if one.source == part.source), 0.0) ** 2 for row in shown])
             for row in shown for part in row.parts}
    named = sorted((source for source in share if source != "noise"), key=lambda source: -float(share[source].mean()))
    other = np.sum([share[source] for source in named[BARS:]], axis=0) if named[BARS:] else np.zeros(len(shown))
    bars = [("noise", BLUE, share["noise"]), *((source_words(source), colour, share[source])
                                               for source, colour in zip(named, COLOURS)), ("others", GREY, other)]

    def paint(axes: Axes) -> None:
        left = np.zeros(len(shown))
        for label, colour, width in bars:
            axes.barh(np.arange(len(shown)), width, 0.7, left=left, color=colour, label=label, zorder=2)
            left = left + width
        name_rows(axes, [row.parameter.replace("_", " ") for row in shown])
        axes.set_xlim(0.0, 1.0)
        finish(axes, len(bars), "share of the variance", "")

    return draw("budget", 1.4 + ROW_IN * len(shown), paint)
