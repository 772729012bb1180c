"""Disagreement of two estimators of one fit, and the one that is reported."""

from __future__ import annotations

import numpy as np

from estimator import MOST_DISAGREEMENT, FitResult
from experiments.judge.numbers import number

METHOD_WORDS = {"mle": "maximum likelihood", "shooting": "multiple shooting"}


def disagreement(result: FitResult) -> str | None:
    """Both estimates that differ most, and which is reported, in a sentence; None where all agree within
    `MOST_DISAGREEMENT` half widths."""
    other = result.second_opinion
    if other is None or other.largest <= MOST_DISAGREEMENT:
        return None
    k = int(np.nanargmax(other.disagreement))
    p = result.mechanism.parameters[k]
    told = (f"two estimators disagree: {p.name} is {with_half_width(result.beta[k], result.half_width[k])} {p.unit} by "
            f"{METHOD_WORDS[result.method]} and {with_half_width(other.beta[k], other.half_width[k])} by "
            f"{METHOD_WORDS[other.method]}, {other.largest:.1f} half widths apart")
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


def with_half_width(value: float, half: float) -> str:
    return f"{number(float(value), float(half))} +- {number(float(half), float(half))}"
