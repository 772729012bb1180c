"""A fit with what may be wrong with its rig: the moved estimate, its wider covariance, and the budget of both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.result import Budget, BudgetPart, FitResult
from estimator.score import (
    MOST_FACTOR,
    STRUCTURE,
    Marginal,
    Nuisance,
    RunScores,
    Score,
    enlarged,
    marginalise,
    projected,
    with_torque_gain,
)

NOISE, SCATTER = "noise", "scatter"


def with_tolerances(result: FitResult, whole: Score, scores: RunScores,
                    known: tuple[NDArray[np.bool_], FloatArray | None], nuisances: Sequence[Nuisance],
                    stated: Mapping[str, tuple[float, ...]]) -> tuple[FitResult, RunScores]:
    """`result` with all nuisances marginalised, and `scores` of its runs where they have moved to.

    `whole` and each of `scores` are over m parameters, of which `known` has the estimated ones (m,) and the information
    of a prior, and the columns of `nuisances`.
    """
    free, prior = known
    full, gain = with_torque_gain(whole, result.beta, result.mechanism, stated)
    found = projected(full, free, prior)
    every, factors = enlarged(found, [*nuisances, *gain])
    marginal = marginalise(found, every)
    step, beyond = np.zeros(full.score.size), tuple(group for group, factor in factors.items() if factor >= MOST_FACTOR)
    if not beyond:
        step[np.flatnonzero(free)], step[free.size :] = marginal.step, marginal.sizes
    p = len(result.beta)
    inside = np.flatnonzero(free[:p])
    more = np.zeros((p, p))
    more[np.ix_(inside, inside)] = marginal.noise[: inside.size, : inside.size]
    noise = result.covariance + more
    parts = _parts(marginal, every, p, inside)
    budget = Budget((BudgetPart(NOISE, _root(noise)), *parts), step[:p], factors, beyond)
    # what of the steps is a wrong scale of the torque moves all runs alike, and no score
    moved = tuple(Score(one.score - one.information @ step[: one.score.size], one.information) for one in scores.scores)
    return (replace(result, beta=result.beta + step[:p], budget=budget,
                    covariance=noise + np.sum([part.covariance for part in parts], axis=0)),
            scores._replace(scores=moved))


def with_scatter(result: FitResult, covariance: FloatArray) -> FitResult:
    """`result` with the `covariance` (p, p) that has in it what runs disagree about; its budget as well."""
    budget = result.budget
    if budget is not None and covariance is not result.covariance:
        part = BudgetPart(SCATTER, _root(covariance - result.covariance))
        budget = replace(budget, parts=(budget.parts[0], part, *budget.parts[1:]))
    return replace(result, covariance=covariance, budget=budget)


def without_tolerances(result: FitResult) -> FloatArray:
    """(p, p) covariance by what the runs show themselves: noise and scatter between runs."""
    if result.budget is None:
        return result.covariance
    found: FloatArray = np.sum([part.covariance for part in result.budget.parts if part.source in (NOISE, SCATTER)],
                               axis=0)
    return found


def _parts(marginal: Marginal, nuisances: Sequence[Nuisance], p: int, inside: NDArray[np.intp]) -> list[BudgetPart]:
    """One for each source, the largest first."""
    rows = np.zeros((len(nuisances), p))
    rows[:, inside] = marginal.directions[:, : inside.size]
    by_source: dict[str, list[int]] = {}
    for k, one in enumerate(nuisances):
        if one.tolerance > 0.0:
            by_source.setdefault(one.source, []).append(k)
    found = []
    for source, which in by_source.items():
        own = rows[which]
        sizes = {} if source == STRUCTURE else {nuisances[k].size: nuisances[k].tolerance for k in which}
        found.append(BudgetPart(source, own if len(own) <= p else _root(own.T @ own), tuple(sizes.values())))
    return found


def _root(covariance: FloatArray) -> FloatArray:
    """(k, p) rows whose outer products add up to the positive part of a covariance (p, p)."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    some = values > 1e-12 * max(float(values[-1]), 1e-300)
    return np.asarray((vectors[:, some] * np.sqrt(values[some])).T * scale)
