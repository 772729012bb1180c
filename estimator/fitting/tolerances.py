"""A fit with what may be wrong with its rig: the moved estimate, its wider covariance, and the budget of both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from daq import BoolArray, FloatArray, IndexArray
from estimator.model import Mechanism
from estimator.result import Budget, BudgetPart, FitResult, LoopTerm
from estimator.score import (
    STRUCTURE,
    Marginal,
    Nuisance,
    RunScores,
    Score,
    discounted,
    enlarged,
    marginalise,
    projected,
    with_torque_gain,
)

NOISE, SCATTER, STEP = "noise", "scatter", "step"


def with_tolerances(result: FitResult, whole: Score, scores: RunScores,
                    known: tuple[BoolArray, FloatArray | None], nuisances: Sequence[Nuisance],
                    stated: Mapping[str, tuple[float, ...]]) -> tuple[FitResult, RunScores]:
    """`result` with all nuisances marginalised, and `scores` of its runs where they have moved to.

    `whole` and each of `scores` are over m parameters, of which `known` has the estimated ones (m,) and the information
    of a prior, and the columns of `nuisances`. The estimate takes the step to the likeliest faults of readings, whose
    forms are known. Laws that the leg may lack have many forms, which imitate each other and the parameters: the
    further step to the likeliest of these counts with a rectangular distribution (JCGM 100, 4.3.7). Tolerances that the
    runs contradict are wider in the covariance and not in the steps: what is wrong then may not be what they are of.
    """
    free = known[0]
    along = np.append(result.beta, np.zeros(free.size - result.beta.size))
    found = tolerated([whole, *scores.scores], known, nuisances, along, result.mechanism, stated)
    if found is None or not np.isfinite(result.covariance).all():
        return result, scores
    p = len(result.beta)
    inside = np.flatnonzero(free[:p])
    noise = result.covariance.copy()
    noise[np.ix_(inside, inside)] += found.marginal.noise[: inside.size, : inside.size]
    parts = [BudgetPart(NOISE, _root(noise)), *_parts(found.marginal, found.nuisances, p, inside),
             BudgetPart(STEP, found.further[None, :p] / np.sqrt(3.0))]
    budget = Budget(tuple(part for part in parts if part.directions.any()), found.step[:p], found.factors)
    moved = tuple(Score(one.score - one.information @ found.step, one.information) for one in found.runs)
    return (replace(result, beta=result.beta + found.step[:p], budget=budget, loop=_loop(result.loop, found, free),
                    covariance=noise + np.sum([part.covariance for part in parts[1:]], axis=0)),
            scores._replace(scores=moved))


def _loop(terms: Sequence[LoopTerm], found: Tolerated, free: BoolArray) -> tuple[LoopTerm, ...]:
    """The last of the estimated values as parameters are: moved, and as uncertain as tolerances make them."""
    marginal, index = found.marginal, np.flatnonzero(free)
    variance = np.diag(marginal.noise) + np.sum(marginal.directions**2, axis=0) + found.further[index] ** 2 / 3.0
    last = zip(terms[::-1], found.step[index][::-1], np.sqrt(np.maximum(variance, 0.0))[::-1])
    return tuple(replace(one, value=one.value + float(step), std=float(np.hypot(one.std, std)))
                 for one, step, std in last)[::-1]


class Tolerated(NamedTuple):
    """Nuisances of a rig, marginalised at a fit with m parameters, of which f are estimated."""

    marginal: Marginal
    nuisances: Sequence[Nuisance]
    """(k,) with the tolerances that the runs ask for, that of the torque's scale last"""
    factors: Mapping[str, float]
    step: FloatArray
    """(m + k,) to the likeliest faults of readings"""
    further: FloatArray
    """(m + k,) from there to the likeliest of all nuisances"""
    runs: Sequence[Score]
    """(R,) over m + k columns"""


def tolerated(scores: Sequence[Score], known: tuple[BoolArray, FloatArray | None],
              nuisances: Sequence[Nuisance], along: FloatArray, mechanism: Mechanism,
              stated: Mapping[str, tuple[float, ...]]) -> Tolerated | None:
    """All `nuisances` with a tolerance, marginalised; None without any. See `with_tolerances`.

    The first of `scores` is that of all runs. `along` (m,) is how the scale of the torque moves the parameters.
    """
    free, prior = known
    used = np.flatnonzero([one.tolerance > 0.0 for one in nuisances])
    columns = np.concatenate([np.arange(free.size), free.size + used])
    full, *runs = (with_torque_gain(one.of(columns), along, mechanism, stated) for one in scores)
    every = [*(nuisances[int(k)] for k in used), *full.nuisances]
    if not every:
        return None
    plain, robust = discounted(projected(full.score, free, prior), free, [one.score for one in runs], every)
    wide, factors = enlarged(plain, every)

    def step(some: Sequence[Nuisance]) -> FloatArray:
        found, out = marginalise(robust, some), np.zeros(full.score.score.size)
        out[np.flatnonzero(free)], out[free.size :] = found.step, found.sizes
        return out

    of_readings = step([one if one.reading else one._replace(tolerance=0.0) for one in every])
    return Tolerated(marginalise(robust, wide), wide, factors, of_readings, step(every) - of_readings,
                     [one.score for one in runs])


def with_scatter(result: FitResult, covariance: FloatArray) -> FitResult:
    """`result` with the `covariance` (p, p) that has in it what runs disagree about; its budget as well."""
    budget = result.budget
    if budget is not None and covariance is not result.covariance:
        part = BudgetPart(SCATTER, _root(covariance - result.covariance))
        budget = replace(budget, parts=(budget.parts[0], part, *budget.parts[1:]))
    return replace(result, covariance=covariance, budget=budget)


def with_tolerances_of(budget: Budget | None, covariance: FloatArray) -> tuple[FloatArray, Budget | None]:
    """`covariance` (p, p) of another estimate from the same runs with what tolerances add to the `budget` of the first,
    and the budget of both."""
    if budget is None:
        return covariance, None
    parts = tuple(part for part in budget.parts if part.source not in (NOISE, SCATTER, STEP))
    whole = covariance + np.sum([part.covariance for part in parts], axis=0)
    return whole, Budget((BudgetPart(NOISE, _root(covariance)), *parts), np.zeros(len(covariance)), budget.enlarged)


def without_tolerances(result: FitResult) -> tuple[FloatArray, FloatArray]:
    """(p,) estimate and (p, p) covariance by what the runs show themselves: noise and scatter between runs."""
    if result.budget is None:
        return result.beta, result.covariance
    own = (part.covariance for part in result.budget.parts if part.source in (NOISE, SCATTER))
    return result.beta - result.budget.moved, sum(own, np.zeros_like(result.covariance))


def _parts(marginal: Marginal, nuisances: Sequence[Nuisance], p: int, inside: IndexArray) -> list[BudgetPart]:
    """One for each source, the largest first."""
    rows = np.zeros((len(nuisances), p))
    rows[:, inside] = marginal.directions[:, : inside.size]
    by_source: dict[str, list[int]] = {}
    for k, one in enumerate(nuisances):
        if one.tolerance > 0.0:
            by_source.setdefault(one.source, []).append(k)
    parts = []
    for source, which in by_source.items():
        own = rows[which]
        sizes = {} if source == STRUCTURE else {nuisances[k].size: nuisances[k].tolerance for k in which}
        parts.append(BudgetPart(source, own if len(own) <= p else _root(own.T @ own), tuple(sizes.values())))
    return parts


def _root(covariance: FloatArray) -> FloatArray:
    """(k, p) rows whose outer products add up to the positive part of a covariance (p, p)."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    some = values > 1e-12 * max(float(values[-1]), 1e-300)
    return np.asarray((vectors[:, some] * np.sqrt(values[some])).T * scale)
