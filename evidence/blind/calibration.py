"""The calibration of stated probabilities: its coefficients by all answers, and what it is worth on families left out.

`python -m evidence.blind.calibration ANSWERS...` prints the coefficients for `estimator.diagnosis.calibration`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from daq import FloatArray
from estimator.diagnosis.calibration import calibrated, terms
from evidence.blind.score import Rate

SPREAD = 3.0
"""Standard deviation of each coefficient before any answer; what few answers do not tell stays near none."""
HIGH = 0.95
Coefficients = tuple[float, float, float]


class Stated(NamedTuple):
    """One answer with a probability."""

    family: str
    in_library: float
    """Its probability if the library has the causes"""
    true: bool


def fit(answers: Sequence[Stated]) -> Coefficients:
    """a, b from zero up, and c: the likeliest, a normal prior of SPREAD about (1, 1, 0), which leaves p as it is."""
    x, y = terms([a.in_library for a in answers]), np.array([a.true for a in answers])

    def misfit(w: FloatArray) -> tuple[float, FloatArray]:
        z, from_prior = x @ w, (w - (1.0, 1.0, 0.0)) / SPREAD**2
        loss = float(np.logaddexp(0.0, np.where(y, -z, z)).sum())
        slope = x.T @ (1.0 / (1.0 + np.exp(-z)) - y) + from_prior
        return loss + 0.5 * float(from_prior @ (w - (1.0, 1.0, 0.0))), slope

    found = minimize(misfit, (1.0, 1.0, 0.0), method="L-BFGS-B", jac=True,
                     bounds=[(0.0, None), (0.0, None), (None, None)])
    a, b, c = map(float, found.x)
    return a, b, c


def left_out(answers: Sequence[Stated]) -> list[float]:
    """Of each answer the calibrated probability by the answers of all other families."""
    others = {name: fit([a for a in answers if a.family != name]) for name in {a.family for a in answers}}
    return [calibrated(a.in_library, others[a.family]) for a in answers]


def table(answers: Sequence[Stated], bins: Sequence[tuple[float, float]]) -> Iterator[str]:
    """Lines of Markdown: true answers by calibrated probability, of families that its calibration has not seen."""
    stated = left_out(answers)
    yield from ["| stated | answers | mean stated | true |", "| --- | --- | --- | --- |"]
    for low, high in [*bins, (0.0, 1.0)]:
        own = [(a, p) for a, p in zip(answers, stated) if low <= p and (p < high or high == 1.0)]
        mean = f"{np.mean([p for _, p in own]):.2f}" if own else "-"
        share = str(Rate(sum(a.true for a, _ in own), len(own))) if own else "-"
        yield f"| {'all' if high - low == 1.0 else f'{low:g} to {high:g}'} | {len(own)} | {mean} | {share} |"


def main() -> None:
    from evidence.blind.page import answer_file, read, stated_of
    from evidence.blind.plan import FAMILIES, RECORDS, choose

    found: list[Stated] = []
    for folder in map(Path, sys.argv[1:]):
        seeds = sorted({int(path.stem.rpartition("-")[2]) for path in folder.glob("*/diagnoses/*.json")})
        cases = choose([family for family in FAMILIES if family != RECORDS], [], seeds)
        found += stated_of(read([case for case in cases if answer_file(case, folder).exists()], folder))
    print(len(found), "answers:", ", ".join(f"{value:.3g}" for value in fit(found)))
    print("\n".join(table(found, [(0.0, 0.5), (0.5, 0.8), (0.8, HIGH), (HIGH, 1.0)])))


if __name__ == "__main__":
    main()
