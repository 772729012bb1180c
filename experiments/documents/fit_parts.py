"""Parts of `legid.fit/1`: what runs, a second estimator, tolerances and prior knowledge say of the parameters."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct

from estimator import FitResult
from experiments.documents.document import Number, known
from experiments.judge import disagreement

Interval = tuple[Number, Number]


class AgreementRow(Struct, frozen=True, kw_only=True):
    """One parameter by the runs."""

    name: Annotated[str, Meta(description="parameter; listed if runs disagree")]
    mean: Annotated[Number, Meta(description="over runs")]
    scatter: Annotated[Number, Meta(description="standard deviation between runs")]
    seen: Annotated[bool, Meta(description="false: the scatter may belong to another parameter")]
    by_run: Annotated[tuple[Number, ...], Meta(description="of each run, shrunk to the mean")]
    widened: Annotated[Number, Meta(description="factor on the interval")]


class Agreement(Struct, frozen=True, kw_only=True):
    """Whether the runs agree about the parameters."""

    unit: Annotated[Literal["run", "segment"], Meta(description="what is compared: run or segment")] = "run"
    runs: Annotated[tuple[str, ...], Meta(description="their names")]
    p_value: Annotated[Number, Meta(description="of equal parameters; null for one run")]
    disagree: Annotated[bool, Meta(description="`ci95` is then by Student's t")]
    parameters: Annotated[tuple[AgreementRow, ...], Meta(description="one entry a parameter")] = ()


class OpinionRow(Struct, frozen=True, kw_only=True):
    """The second estimate of one parameter."""

    name: Annotated[str, Meta(description="parameter")]
    value: Annotated[Number, Meta(description="by the other method")]
    ci95: Annotated[Interval, Meta(description="its 95 % interval")]
    disagreement: Annotated[float, Meta(description="in half widths")]


class Held(Struct, frozen=True, kw_only=True):
    """Errors of both methods on held-out seconds."""

    gain: Annotated[float, Meta(description="share by which the rms error is lower with shooting")]
    ci95: Annotated[tuple[float, float], Meta(description="its 95 % interval")]
    segments: Annotated[int, Meta(description="seconds predicted")]


class Opinion(Struct, frozen=True, kw_only=True):
    """The same data by a method that fails differently."""

    method: Annotated[str, Meta(description="of this estimate")]
    disagreement: Annotated[float, Meta(description="the largest, in [half widths](docs/trust.md#a-second-opinion)")]
    reported: Annotated[str, Meta(description="the method of the fit's `parameters`")] = "mle"
    parameters: Annotated[tuple[OpinionRow, ...], Meta(description="those that are compared")]
    not_compared: Annotated[tuple[str, ...], Meta(description="names of the others")] = ()
    held_out: Annotated[Held | None, Meta(description="null: not asked, or too little data")] = None
    why: Annotated[str, Meta(description="the disagreement in a sentence; empty without one")] = ""


class Part(Struct, frozen=True, kw_only=True):
    """One source of uncertainty of a parameter."""

    source: Annotated[str, Meta(description="its name")]
    std: Annotated[Number, Meta(description="standard deviation that it would make alone")]
    tolerance: Annotated[tuple[float, ...], Meta(description="1 sigma of each size of an effect, SI")] = ()


class BudgetRow(Struct, frozen=True, kw_only=True):
    """The interval of one parameter as the sum of its parts."""

    parameter: Annotated[str, Meta(description="its name")]
    half_width: Annotated[Number, Meta(description="half of its 95 % interval")]
    moved: Annotated[Number, Meta(description="how far tolerances moved the estimate")]
    parts: Annotated[tuple[Part, ...], Meta(description="the largest first")]


class Prior(Struct, frozen=True, kw_only=True):
    """A value that was known before the fit."""

    name: Annotated[str, Meta(description="of the body value or parameter")]
    value: Annotated[float, Meta(description="as given")]
    std: Annotated[float, Meta(description="as given")]
    fitted: Annotated[float, Meta(description="after the fit")]
    fitted_std: Annotated[float, Meta(description="after the fit")]
    contradiction: Annotated[float, Meta(description="in standard deviations")]


class Next(Struct, frozen=True, kw_only=True):
    """The value to measure next."""

    name: Annotated[str, Meta(description="parameter, body value or source of the budget")]
    value: Annotated[Number, Meta(description="as it is now")]
    std: Annotated[Number, Meta(description="of the measurement")]
    widths: Annotated[dict[str, Number], Meta(description="other intervals then, as shares of now")]
    share: Annotated[Number, Meta(description="their geometric mean")]
    undetermined: Annotated[tuple[int, int], Meta(description="open combinations, now and then")]
    text: Annotated[str, Meta(description="all of it in a sentence")] = ""


def agreement_of(result: FitResult) -> Agreement | None:
    """None where nobody asked."""
    found = result.agreement
    if found is None:
        return None
    rows = () if not found.disagree else tuple(
        AgreementRow(name=p.name, mean=known(found.mean[k]), scatter=known(found.scatter[k]), seen=bool(found.seen[k]),
                     by_run=tuple(map(known, found.by_run[:, k])), widened=known(result.widening[k]))
        for k, p in enumerate(result.mechanism.parameters) if p.name not in unvaried(result))
    return Agreement(unit=found.unit, runs=found.runs, p_value=found.p_value, disagree=bool(found.disagree),
                     parameters=rows)


def opinion_of(result: FitResult) -> Opinion | None:
    """None without a second opinion."""
    other = result.second_opinion
    if other is None:
        return None
    rows = zip(result.mechanism.names, *(map(float, x) for x in (other.beta, other.half_width, other.disagreement)))
    held = other.held_out
    return Opinion(
        method=other.method, disagreement=other.largest, reported=result.method,
        parameters=tuple(OpinionRow(name=name, value=known(value), ci95=(known(value - half), known(value + half)),
                                    disagreement=apart) for name, value, half, apart in rows if np.isfinite(apart)),
        not_compared=tuple(name for name, apart in zip(result.mechanism.names, other.disagreement)
                           if not np.isfinite(apart)),
        held_out=None if held is None else Held(gain=held.gain, ci95=held.ci95, segments=held.segments),
        why=disagreement(result) or "")


def budget_of(result: FitResult) -> tuple[BudgetRow, ...] | None:
    """None without a budget."""
    budget = result.budget
    if budget is None:
        return None
    return tuple(BudgetRow(
        parameter=p.name, half_width=known(result.half_width[k]), moved=known(budget.moved[k]),
        parts=tuple(Part(source=part.source, std=known(part.std[k]), tolerance=tuple(part.tolerance))
                    for part in sorted(budget.parts, key=lambda part: -part.std[k])))
        for k, p in enumerate(result.mechanism.parameters) if p.name not in unvaried(result))


def unvaried(result: FitResult) -> set[str]:
    """Names of the parameters that were given, are at a bound, or are not determined."""
    return {*result.fixed, *result.at_bound, *result.open_parameters}
