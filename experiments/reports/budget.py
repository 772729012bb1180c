"""The uncertainty budget of a fit: as a sentence, a line, a table, JSON, and a bar for each parameter."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from estimator import FitResult
from experiments.judge import LEAST_PART, PARTS_TOLD, number, parts_of, precision, source_words
from experiments.reports.diagnosis_figures import ROW_IN, draw
from experiments.reports.figures import BLUE, GREEN, GREY, INK, ORANGE, finish
from experiments.reports.html import Picture, Section, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BARS = 5
"""Sources with a colour of their own in a bar."""
COLOURS = (ORANGE, GREEN, INK, "#c9a227", "#8a5fb0")
HEADER = ["parameter", "value", "+- (95 %)", "largest parts, each alone"]


def budget_rows(result: FitResult) -> list[list[str]]:
    """One row of HEADER for each estimated parameter."""
    rows = []
    for k, p in enumerate(result.mechanism.parameters):
        if p.name in {*result.fixed, *result.at_bound, *result.open_parameters} or not result.std[k] > 0.0:
            continue
        half, std = float(result.half_width[k]), float(result.std[k])
        parts = [f"{source_words(source)} {number(part, std)}" for source, part in parts_of(result, k).items()
                 if part > LEAST_PART * half]
        rows.append([p.name, number(float(result.beta[k]), std), number(half, std), ", ".join(parts[: PARTS_TOLD + 1])])
    return rows


def budget_lines(result: FitResult) -> list[str]:
    """For a terminal; none without a budget."""
    if result.budget is None:
        return []
    told = precision(result)
    lines = [f"budget: {told}"] if told else []
    if result.budget.enlarged:
        grown = ", ".join(f"{group} {factor:.2g} times" for group, factor in
                          sorted(result.budget.enlarged.items(), key=lambda pair: -pair[1]))
        lines.append(f"the runs ask for larger tolerances: {grown}")
    return lines


def budget_document(result: FitResult) -> list[dict[str, Any]] | None:
    """For the JSON documents; None without a budget."""
    if result.budget is None:
        return None
    rows = []
    for k, p in enumerate(result.mechanism.parameters):
        if p.name in {*result.fixed, *result.at_bound, *result.open_parameters}:
            continue
        parts = sorted(result.budget.parts, key=lambda part: -part.std[k])
        rows.append({"parameter": p.name, "half_width": float(result.half_width[k]),
                     "moved": float(result.budget.moved[k]),
                     "parts": [{"source": part.source, "std": float(part.std[k]), "tolerance": list(part.tolerance)}
                               for part in parts]})
    return rows


def budget_section(result: FitResult) -> list[Section]:
    """For the page: a bar for each parameter; empty without a budget."""
    rows = budget_rows(result)
    if result.budget is None or not rows:
        return []
    text = ["Each bar is the variance of a parameter, as the sum of its parts. Noise and scatter between runs come "
            "from the runs. All else are tolerances, which rig.toml states under [tolerance], or which have a default.",
            *(f"{line[:1].upper()}{line[1:]}." for line in budget_lines(result))]
    return [Section("What the intervals consist of", text, [Table(HEADER, rows, right=frozenset({1, 2}))],
                    [Picture(_bars(result), "Share of each source in the variance of each parameter.")])]


def _bars(result: FitResult) -> str:
    parts = {part.source: part.std**2 for part in result.budget.parts} if result.budget else {}
    shown = [k for k, p in enumerate(result.mechanism.parameters) if result.std[k] > 0.0 and p.name not in
             {*result.fixed, *result.at_bound, *result.open_parameters}]
    share = {source: variance[shown] / np.diag(result.covariance)[shown] for source, variance in parts.items()}
    named = sorted((source for source in share if source != "noise"), key=lambda source: -float(share[source].mean()))
    other = np.sum([share[source] for source in named[BARS:]], axis=0) if named[BARS:] else np.zeros(len(shown))
    bars = [("noise", BLUE, share["noise"]), *((source_words(source), colour, share[source])
                                               for source, colour in zip(named, COLOURS)), ("others", GREY, other)]

    def paint(axes: Axes) -> None:
        left = np.zeros(len(shown))
        for label, colour, width in bars:
            axes.barh(np.arange(len(shown)), width, 0.7, left=left, color=colour, label=label, zorder=2)
            left = left + width
        axes.set_yticks(np.arange(len(shown)), [re.sub(r"_", " ", result.mechanism.names[k]) for k in shown])
        axes.invert_yaxis()
        axes.set_xlim(0.0, 1.0)
        axes.grid(visible=False, axis="y")
        finish(axes, len(bars), "share of the variance", "")

    return draw("budget", 1.4 + ROW_IN * len(shown), paint)
