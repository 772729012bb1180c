"""Whether the runs of a fit agree, for a terminal, a page and the JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from estimator import FitResult
from experiments.judge import WIDENED, disputed, number
from experiments.reports.html import Section, Table

LEAST_P = 1e-9
"""Probabilities below this are told as being below: so far out nobody knows the distribution."""
MOST_RUNS = 8
"""Runs whose values stand side by side on a page."""


def agreement_lines(result: FitResult) -> list[str]:
    """One line about all, then one for each parameter that the runs disagree about; none where nobody asked."""
    found = result.agreement
    if found is None:
        return []
    if found.p_value is None:
        return ["one run gives no scatter between runs: intervals include its noise alone"]
    count, unit = len(found.runs), f"{found.unit}s"
    if not found.disagree:
        return [f"{count} {unit} agree within their noise ({_p(found.p_value)})"]
    lines = [f"{count} {unit} disagree by more than their noise ({_p(found.p_value)}): {_widened(result)}"]
    for k in disputed(result):
        parameter, scatter = result.mechanism.parameters[k], float(found.scatter[k])
        low, high = float(found.by_run[:, k].min()), float(found.by_run[:, k].max())
        lines.append(f"{unit} disagree about {parameter.name} ({parameter.meaning}): {number(low, scatter)} .. "
                     f"{number(high, scatter)}, scatter {number(scatter, scatter)} about "
                     f"{number(float(found.mean[k]), scatter)}; interval widened {result.widening[k]:.1f} times")
    return lines


def agreement_section(result: FitResult) -> list[Section]:
    """Section on disagreements between runs, with the values of each; empty where nobody asked."""
    found, lines = result.agreement, agreement_lines(result)
    if found is None:
        return []
    if not found.disagree:
        return [Section(f"Do the {found.unit}s agree?", [f"{lines[0][:1].upper()}{lines[0][1:]}."])]
    text = [f"{lines[0][:1].upper()}{lines[0][1:]}.",
            f"Mean and scatter are those of {found.unit}s that each have parameters of their own, to first order at "
            f"the values above. A {found.unit}'s own value is shrunk to the mean by its uncertainty. Where the "
            "scatter stands in brackets, most of it is not observed: it may belong to another parameter."]
    each = len(found.runs) <= MOST_RUNS
    over, by_run = [], []
    for k, p in enumerate(result.mechanism.parameters):
        scatter = float(found.scatter[k])
        if p.name in result.fixed or p.name in result.at_bound or p.name in result.open_parameters:
            continue
        told = number(scatter, scatter)
        own = found.by_run[:, k] if each else np.array([found.by_run[:, k].min(), found.by_run[:, k].max()])
        over.append([p.name, number(float(found.mean[k]), scatter), told if found.seen[k] else f"({told})",
                     f"{result.widening[k]:.1f} times", p.unit, p.meaning])
        by_run.append([p.name, *(number(float(x), scatter) for x in own), p.unit])
    runs = list(found.runs) if each else ["lowest", "highest"]
    return [Section(f"Do the {found.unit}s agree?", text, [
        Table(["parameter", "mean", "scatter", "interval widened", "unit", "meaning"], over,
              f"Over all {found.unit}s",
              frozenset({1, 2, 3})),
        Table(["parameter", *runs, "unit"], by_run,
              f"{found.unit.capitalize()} by {found.unit}" if each else f"The {found.unit}s furthest apart",
              frozenset(range(1, len(runs) + 1)))])]


def agreement_document(result: FitResult) -> dict[str, Any] | None:
    """For the JSON of a fit; None where nobody asked."""
    found = result.agreement
    if found is None:
        return None
    parameters = [] if not found.disagree else [
        {"name": p.name, "mean": float(found.mean[k]), "scatter": float(found.scatter[k]), "seen": bool(found.seen[k]),
         "by_run": [float(x) for x in found.by_run[:, k]], "widened": float(result.widening[k])}
        for k, p in enumerate(result.mechanism.parameters)
        if p.name not in {*result.fixed, *result.at_bound, *result.open_parameters}]
    return {"unit": found.unit, "runs": list(found.runs), "p_value": found.p_value, "disagree": found.disagree,
            "parameters": parameters}


def _widened(result: FitResult) -> str:
    names = {*result.fixed, *result.at_bound, *result.open_parameters}
    wide = [float(x) for p, x in zip(result.mechanism.parameters, result.widening)
            if p.name not in names and x > WIDENED]
    if not wide:
        return "too little to widen an interval"
    span = f"{min(wide):.1f}" if len(wide) == 1 else f"{min(wide):.1f} to {max(wide):.1f}"
    return f"intervals allow for it, {span} times as wide as by noise alone"


def _p(value: float) -> str:
    return f"p < {LEAST_P:.0e}" if value < LEAST_P else f"p = {value:.1g}"
