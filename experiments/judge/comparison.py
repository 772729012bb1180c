"""Two models side by side, as text and document: `legid compare`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from estimator.prediction import PredictionTable
from experiments.judge.numbers import Estimate
from experiments.judge.trust import Trust
from experiments.session import SetAside

CHANCE = 0.1
"""Share of sensors and horizons at which one of two equal models may come out better: 95 % intervals, and several of
them of the same errors."""
NAMES = ("A", "B")
TOLD = 3
"""Errors named in a sentence."""


@dataclass(frozen=True)
class ParameterPair:
    """One parameter, or size of an effect, in both models; None where a model has none."""

    name: str
    unit: str
    meaning: str
    a: Estimate | None
    b: Estimate | None

    @property
    def z(self) -> float | None:
        """Difference over its standard deviation, the two taken for independent; None where it is not known."""
        if self.a is None or self.b is None:
            return None
        std = math.hypot(self.a[1], self.b[1])
        return (self.b[0] - self.a[0]) / std if 0.0 < std < math.inf else None


@dataclass(frozen=True)
class HorizonError:
    """Free-run rms errors of one sensor over one horizon; infinite where a model diverged."""

    horizon_s: float
    """Infinite for whole segments."""
    column: str
    a: float
    b: float
    ci95: tuple[float, float] | None
    """Of B / A, by the scatter between runs, or between blocks of few runs; None where there are too few."""

    @property
    def better(self) -> str:
        """A, B, or nothing where the interval holds 1 or is not known."""
        if math.isinf(self.a) != math.isinf(self.b):
            return "B" if math.isinf(self.a) else "A"
        return "" if self.ci95 is None else "B" if self.ci95[1] < 1.0 else "A" if self.ci95[0] > 1.0 else ""


def horizon_errors(table: PredictionTable) -> Iterator[HorizonError]:
    """One a horizon and sensor of a table of A and B."""
    for horizon_s in table.horizons_s:
        for column in table.judged:
            a, b = (table.rms(k, column, horizon_s) for k in (0, 1))
            yield HorizonError(horizon_s, column, a, b, table.compared(1, 0, column, horizon_s).ci95)


@dataclass(frozen=True)
class Comparison:
    """Everything that `legid compare` found."""

    files: tuple[str, str]
    parameters: tuple[ParameterPair, ...]
    errors: tuple[HorizonError, ...]
    table: PredictionTable
    """Of A and B"""
    runs: tuple[str, ...]
    flags: tuple[str, ...]
    """What limits the answer: runs that were fitted, rigs that differ."""
    notes: tuple[str, ...] = ()
    """What limits the reading of z."""
    set_aside: tuple[SetAside, ...] = ()
    """Runs that were not used."""


def comparison_trust(comparison: Comparison) -> Trust:
    """The better model, in one line."""
    total, files = len(comparison.errors), dict(zip(NAMES, comparison.files))
    wins = {name: [e for e in comparison.errors if e.better == name] for name in NAMES}
    wins = {name: some if len(some) > CHANCE * total else [] for name, some in wins.items()}
    reasons = (*comparison.flags, *comparison.notes)
    if comparison.errors and all(e.ci95 is None and not e.better for e in comparison.errors):
        smaller = sum(e.b < e.a for e in comparison.errors)
        return Trust("caution", "NOT DECIDED: these runs are too short for an interval.",
                     (f"The error of B is smaller at {smaller} of {total} sensors and horizons.", *reasons),
                     "Record ten seconds or more")
    if wins["A"] and wins["B"]:
        parts = " and ".join(f"{name}{_of(files[name], name)} at {_places(wins[name])}" for name in NAMES)
        return Trust("caution", f"NEITHER is better throughout: {parts}.", reasons)
    for name in NAMES:
        if wins[name]:
            best = min(wins[name], key=lambda e: _ratio(e) if name == "B" else -_ratio(e))
            told = f"{_ratio(best):.2g}" + (
                "" if best.ci95 is None else f" [{best.ci95[0]:.2g}, {best.ci95[1]:.2g}]") if math.isfinite(
                    _ratio(best)) else "one of them diverged"
            return Trust("caution" if comparison.flags else "good",
                         f"{name} IS BETTER{_of(files[name], name)}: at {len(wins[name])} of {total} sensors and "
                         "horizons, the other at no more than chance allows.",
                         (f"Largest difference: {_place(best)}, rms error of B over A {told}.", *reasons))
    return Trust("caution", f"NEITHER is better: over {total} sensors and horizons, no more differences are "
                 "significant than chance allows.", reasons)


def _of(file: str, name: str) -> str:
    """The file of a model, unless it is called by its letter alone."""
    return "" if file == name else f" ({file})"


def _ratio(error: HorizonError) -> float:
    if math.isfinite(error.a) and error.a > 0.0:
        return error.b / error.a
    return 0.0 if math.isfinite(error.b) else math.inf


def _place(error: HorizonError) -> str:
    return f"{error.column} over {horizon_text(error.horizon_s)}"


def _places(errors: Sequence[HorizonError]) -> str:
    more = f" and {len(errors) - TOLD} more" if len(errors) > TOLD else ""
    return ", ".join(map(_place, errors[:TOLD])) + more


def horizon_text(horizon_s: float) -> str:
    """For a person."""
    return "whole runs" if math.isinf(horizon_s) else f"{horizon_s:g} s"


