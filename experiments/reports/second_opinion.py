"""Second estimator's opinion of a fit, as text, JSON and a section of the page."""

from __future__ import annotations

from typing import Any

import numpy as np

from estimator import MOST_DISAGREEMENT, FitResult
from experiments.judge import METHOD_WORDS, disagreement, with_half_width
from experiments.reports.html import Section, Table


def opinion_lines(result: FitResult) -> list[str]:
    """For a terminal; none without a second opinion."""
    other = result.second_opinion
    if other is None:
        return []
    left_out = _not_compared(result)
    told = f"second opinion, by {METHOD_WORDS[other.method]}: "
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
    rows = [[p.name, with_half_width(result.beta[k], result.half_width[k]),
             with_half_width(other.beta[k], other.half_width[k]), f"{other.disagreement[k]:.2g}", p.unit, p.meaning]
            for k, p in enumerate(result.mechanism.parameters) if np.isfinite(other.disagreement[k])]
    ours, theirs = METHOD_WORDS[result.method], METHOD_WORDS[other.method]
    told = (f"The same data by {theirs}, which fails differently. Disagreement: difference over the root of both "
            f"squared half widths; above {MOST_DISAGREEMENT:g} the fit is not trusted.")
    why = disagreement(result)
    left_out = _not_compared(result)
    return [Section("Second opinion", [told, *([f"{why[:1].upper()}{why[1:]}."] if why else [])], [
        Table(["parameter", f"{ours} (reported)", theirs, "disagreement", "unit", "meaning"], rows,
              right=frozenset({1, 2, 3}))],
        notes=[f"Not compared because given, at a bound, or not determined by both: {', '.join(left_out)}."]
        if left_out else [])]
