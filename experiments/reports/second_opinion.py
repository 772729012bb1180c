"""Second estimator's opinion of a fit, as text and a section of the page."""

from __future__ import annotations

from estimator import MOST_DISAGREEMENT
from experiments.documents import FitDocument, finite
from experiments.judge import METHOD_WORDS, sentence_of, with_half_width
from experiments.reports.html import Section, Table


def opinion_lines(fit: FitDocument) -> list[str]:
    """For a terminal; none without a second opinion."""
    other = fit.second_opinion
    if other is None:
        return []
    told = f"second opinion, by {METHOD_WORDS[other.method]}: "
    if not other.parameters:
        return [f"{told}it determines no parameter of these"]
    name = max(other.parameters, key=lambda row: row.disagreement).name
    told += f"largest disagreement {other.disagreement:.2g} half widths, in {name}"
    return [told + (f"; not compared: {', '.join(other.not_compared)}" if other.not_compared else "")]


def opinion_section(fit: FitDocument) -> Section | None:
    """For the page; none without a second opinion."""
    other = fit.second_opinion
    if other is None:
        return None
    parameters = {p.name: p for p in fit.parameters}
    rows = [[row.name, _with_half(parameters[row.name].value, parameters[row.name].ci95),
             _with_half(row.value, row.ci95), f"{row.disagreement:.2g}", parameters[row.name].unit,
             parameters[row.name].meaning] for row in other.parameters]
    ours, theirs = METHOD_WORDS[fit.method], METHOD_WORDS[other.method]
    told = (f"The same data by {theirs}, which fails differently. Disagreement: difference over the root of both "
            f"squared half widths; above {MOST_DISAGREEMENT:g} the fit is not trusted.")
    return Section("Second opinion", [told, *([sentence_of(other.why)] if other.why else [])], [
        Table(["parameter", f"{ours} (reported)", theirs, "disagreement", "unit", "meaning"], rows, {1, 2, 3})],
        notes=[f"Not compared because given, at a bound, or not determined by both: {', '.join(other.not_compared)}."]
        if other.not_compared else [])


def _with_half(value: float | None, ci95: tuple[float | None, float | None]) -> str:
    low, high = map(finite, ci95)
    return with_half_width(finite(value), (high - low) / 2.0)
