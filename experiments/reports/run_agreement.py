"""Whether the runs of a fit agree, for a terminal and a page."""

from __future__ import annotations

from experiments.documents import FitDocument, finite
from experiments.judge import WIDENED, number, sentence_of
from experiments.reports.html import Section, Table

LEAST_P = 1e-9
"""Probabilities below this are told as being below: so far out nobody knows the distribution."""
MOST_RUNS = 8
"""Runs whose values stand side by side on a page."""


def agreement_lines(fit: FitDocument) -> list[str]:
    """One line about all, then one for each parameter that the runs disagree about; none where nobody asked."""
    found = fit.agreement
    if found is None:
        return []
    if found.p_value is None:
        return ["one run gives no scatter between runs: intervals include its noise alone"]
    count, unit = len(found.runs), f"{found.unit}s"
    if not found.disagree:
        return [f"{count} {unit} agree within their noise ({_p(found.p_value)})"]
    lines = [f"{count} {unit} disagree by more than their noise ({_p(found.p_value)}): {_widened(fit)}"]
    meaning = {p.name: p.meaning for p in fit.parameters}
    for row in found.parameters:
        if not row.seen or finite(row.widened) <= WIDENED:
            continue
        scatter, own = finite(row.scatter), list(map(finite, row.by_run))
        lines.append(f"{unit} disagree about {row.name} ({meaning[row.name]}): {number(min(own), scatter)} .. "
                     f"{number(max(own), scatter)}, scatter {number(scatter, scatter)} about "
                     f"{number(finite(row.mean), scatter)}; interval widened {finite(row.widened):.1f} times")
    return lines


def agreement_section(fit: FitDocument) -> Section | None:
    """Section on disagreements between runs, with the values of each; None where nobody asked."""
    found, lines = fit.agreement, agreement_lines(fit)
    if found is None:
        return None
    if not found.disagree:
        return Section(f"Do the {found.unit}s agree?", [sentence_of(lines[0])])
    text = [sentence_of(lines[0]),
            f"Mean and scatter are those of {found.unit}s that each have parameters of their own, to first order at "
            f"the values above. A {found.unit}'s own value is shrunk to the mean by its uncertainty. Where the "
            "scatter stands in brackets, most of it is not observed: it may belong to another parameter."]
    each = len(found.runs) <= MOST_RUNS
    over, by_run = [], []
    parameters = {p.name: p for p in fit.parameters}
    for row in found.parameters:
        scatter, p = finite(row.scatter), parameters[row.name]
        told, values = number(scatter, scatter), list(map(finite, row.by_run))
        own = values if each else [min(values), max(values)]
        over.append([p.name, number(finite(row.mean), scatter), told if row.seen else f"({told})",
                     f"{finite(row.widened):.1f} times", p.unit, p.meaning])
        by_run.append([p.name, *(number(x, scatter) for x in own), p.unit])
    runs = list(found.runs) if each else ["lowest", "highest"]
    return Section(f"Do the {found.unit}s agree?", text, [
        Table(["parameter", "mean", "scatter", "interval widened", "unit", "meaning"], over, {1, 2, 3},
              f"Over all {found.unit}s"),
        Table(["parameter", *runs, "unit"], by_run, range(1, len(runs) + 1),
              f"{found.unit.capitalize()} by {found.unit}" if each else f"The {found.unit}s furthest apart")])


def _widened(fit: FitDocument) -> str:
    rows = fit.agreement.parameters if fit.agreement else ()
    wide = [x for row in rows if (x := finite(row.widened)) > WIDENED]
    if not wide:
        return "too little to widen an interval"
    span = f"{min(wide):.1f}" if len(wide) == 1 else f"{min(wide):.1f} to {max(wide):.1f}"
    return f"intervals allow for it, {span} times as wide as by noise alone"


def _p(value: float) -> str:
    return f"p < {LEAST_P:.0e}" if value < LEAST_P else f"p = {value:.1g}"
