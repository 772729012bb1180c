"""Second estimator's opinion of a fit, as text, JSON and a section of the page."""

from __future__ import annotations

from typing import Any

import numpy as np

from estimator import MOST_DISAGREEMENT, FitResult
from experiments.reports.html import Section, Table
from experiments.reports.numbers import number

WORDS = {"mle": "maximum likelihood", "shooting": "multiple shooting"}


def disagreement(result: FitResult) -> str | None:
    """Both estimates that differ most, and which is reported, in a sentence; None where all agree within
    `MOST_DISAGREEMENT` half widths."""
    other = result.second_opinion
    if other is None or other.largest <= MOST_DISAGREEMENT:
        return None
    k = int(np.nanargmax(other.disagreement))
    p = result.mechanism.parameters[k]
    told = (f"two estimators disagree: {p.name} is {_value(result.beta[k], result.half_width[k])} {p.unit} by "
            f"{WORDS[result.method]} and {_value(other.beta[k], other.half_width[k])} by {WORDS[other.method]}, "
            f"{other.largest:.1f} half widths apart")
    return f"{told}; {_decision(result)}"


def _decision(result: FitResult) -> str:
    """How the estimate was chosen that is reported."""
    found = result.second_opinion and result.second_opinion.held_out
    if not found:
        return "too little data to let held-out data decide"
    low, high = (100.0 * x for x in found.ci95)
    gain = 100.0 * found.gain
    if result.method == "shooting":
        return f"shooting is reported, its error on held-out seconds is {gain:.0f} % lower [{low:.0f}, {high:.0f}]"
    if high < 0.0:
        return f"shooting's error on held-out seconds is {-gain:.0f} % higher [{-high:.0f}, {-low:.0f}]"
    return f"held-out seconds do not decide (shooting's error is {gain:.0f} % lower [{low:.0f}, {high:.0f}])"


def _value(value: float, half: float) -> str:
    return f"{number(float(value), float(half))} +- {number(float(half), float(half))}"


def opinion_lines(result: FitResult) -> list[str]:
    """For a terminal; none without a second opinion."""
    other = result.second_opinion
    if other is None:
        return []
    left_out = _not_compared(result)
    told = f"second opinion, by {WORDS[other.method]}: "
    if len(left_out) == len(result.mechanism.names):
        return [f"{told}it determines no parameter of these"]
    name = result.mechanism.names[int(np.nanargmax(other.disagreement))]
    told += f"largest disagreement {other.largest:.2g} half widths, in {name}"
    return [told + (f"; not compared: {', '.join(left_out)}" if left_out else "")]


def _not_compared(result: FitResult) -> list[str]:
    other = result.second_opinion
    return [] if other is None else [name for name, apart in zip(result.mechanism.names, other.disagreement)
                                     if not np.isfinite(apart)]


def opinion_document(result: FitResult) -> dict[str, Any] | None:
    """For fit JSON; null without a second opinion."""
    other = result.second_opinion
    if other is None:
        return None
    rows = zip(result.mechanism.names, map(float, other.beta), map(float, other.half_width), other.disagreement)
    held = other.held_out
    return {"method": other.method, "disagreement": other.largest, "reported": result.method,
            "parameters": [{"name": name, "value": value, "ci95": [value - half, value + half],
                            "disagreement": float(apart)} for name, value, half, apart in rows
                           if np.isfinite(apart)],
            "not_compared": _not_compared(result),
            "held_out": None if held is None else {"gain": held.gain, "ci95": list(held.ci95),
                                                   "segments": held.segments}}


def opinion_section(result: FitResult) -> list[Section]:
    """For the page; none without a second opinion."""
    other = result.second_opinion
    if other is None:
        return []
    rows = [[p.name, _value(result.beta[k], result.half_width[k]), _value(other.beta[k], other.half_width[k]),
             f"{other.disagreement[k]:.2g}", p.unit, p.meaning]
            for k, p in enumerate(result.mechanism.parameters) if np.isfinite(other.disagreement[k])]
    told = (f"The same data by {WORDS[other.method]}, which fails differently. Disagreement: difference over the root "
            f"of both squared half widths; above {MOST_DISAGREEMENT:g} the fit is not trusted.")
    why = disagreement(result)
    left_out = _not_compared(result)
    return [Section("Second opinion", [told, *([f"{why[:1].upper()}{why[1:]}."] if why else [])], [
        Table(["parameter", f"{WORDS[result.method]} (reported)", WORDS[other.method], "disagreement", "unit",
               "meaning"], rows, right=frozenset({1, 2, 3}))],
        notes=[f"Not compared because given, at a bound, or not determined by both: {', '.join(left_out)}."]
        if left_out else [])]
