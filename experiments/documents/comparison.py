"""`legid.comparison/1`: two models on the same runs, as `legid compare --json` writes them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal, Self

from msgspec import UNSET, Meta, Struct

from daq import Dataset
from experiments.documents.document import Aside, Damaged, Document, From, Number, known
from experiments.judge import Comparison, Estimate, Headline, HorizonError, Trust, comparison_trust
from experiments.session import damaged_runs


class Value(Struct, frozen=True, kw_only=True):
    """A parameter as one model has it."""

    value: Annotated[float, Meta(description="in the unit")]
    std: Annotated[Number, Meta(description="standard deviation, or null")]
    ci95: Annotated[tuple[Number, Number], Meta(description="95 % interval, or nulls")]


class Pair(Struct, frozen=True, kw_only=True):
    """One parameter, or size of an effect, in both models."""

    name: Annotated[str, Meta(description="the parameter, or effect and size")]
    unit: Annotated[str, Meta(description="its unit")]
    meaning: Annotated[str, Meta(description="its meaning")]
    a: Annotated[Value | None, Meta(description="in model A; null if it has none")]
    b: Annotated[Value | None, Meta(description="in model B")]
    z: Annotated[Number, Meta(description="B less A over its standard deviation, or null")]


class ErrorPair(Struct, frozen=True, kw_only=True):
    """Free-run rms errors of one sensor over one horizon."""

    horizon_s: Annotated[Number, Meta(description="length of the pieces [s]; null: whole segments")]
    column: Annotated[str, Meta(description="the sensor")]
    a: Annotated[Number, Meta(description="rms error of A; null if it diverged")]
    b: Annotated[Number, Meta(description="rms error of B")]
    ratio: Annotated[Number, Meta(description="B / A")]
    ratio_ci95: Annotated[tuple[float, float] | None, Meta(description="its 95 % interval, or null")]
    better: Annotated[str | None, Meta(description="A, B or null")]

    @property
    def length_s(self) -> float:
        """Length of the pieces [s]; infinite for whole segments."""
        return math.inf if self.horizon_s is None else self.horizon_s


class ComparisonDocument(Document, kw_only=True):
    """Two models on the same runs: parameters, free-run errors over horizons, and which one is better."""

    schema: Annotated[Literal["legid.comparison/1"], Meta(description="of this document")] = "legid.comparison/1"
    models: Annotated[tuple[str, str], Meta(description="A and B")]
    runs: Annotated[tuple[str, ...], Meta(description="that were used")]
    parameters: Annotated[tuple[Pair, ...], Meta(description="one entry a parameter")]
    errors: Annotated[tuple[ErrorPair, ...], Meta(description="one entry a horizon and sensor")]
    trust: Annotated[Trust, Meta(description="the first line: the better model, and where")]
    set_aside: Aside = ()
    damaged: Damaged = ()
    provenance: From = UNSET

    @property
    def headline(self) -> Headline:
        """First lines: the trust in it."""
        return self.trust.headline

    @classmethod
    def of(cls, comparison: Comparison, runs: Sequence[Dataset] = ()) -> Self:
        """The document of a comparison on `runs`."""
        return cls(models=comparison.files, runs=comparison.runs,
                   parameters=tuple(Pair(name=p.name, unit=p.unit, meaning=p.meaning, a=_value(p.a), b=_value(p.b),
                                         z=p.z) for p in comparison.parameters),
                   errors=tuple(map(_errors, comparison.errors)), trust=comparison_trust(comparison),
                   set_aside=comparison.set_aside, damaged=tuple(damaged_runs(runs)))


def _value(estimate: Estimate | None) -> Value | None:
    return None if estimate is None else Value(value=estimate.value, std=known(estimate.std),
                                               ci95=(known(estimate.low), known(estimate.high)))


def _errors(e: HorizonError) -> ErrorPair:
    ratio = e.b / e.a if math.isfinite(e.a + e.b) and e.a > 0.0 else None
    return ErrorPair(horizon_s=known(e.horizon_s), column=e.column, a=known(e.a), b=known(e.b), ratio=ratio,
                     ratio_ci95=e.ci95, better=e.better or None)
