"""`with_tolerances`: a diagnosis' model with what may be wrong with the rig, as a fit has it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import FloatArray
from estimator.diagnosis.model import Model, score_train
from estimator.fitting import Tolerated, tolerated
from estimator.likelihood import Candidate
from estimator.score import (
    BEYOND,
    Nuisance,
    RunScores,
    Score,
    agreement_of,
    nuisance_candidates,
    nuisances_of,
    torque_power,
    total,
)


def with_tolerances(model: Model, covariance: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """(w,) the leg's parameters and sizes, (w, w) their covariance, the tolerances of the rig marginalised as in a fit.

    `covariance` is that of noise and of what the train runs disagree about. The estimate takes the step to the
    likeliest faults of readings; the further step to laws counts with a rectangular distribution (JCGM 100, 4.3.7). The
    model stays at its optimum, by which free runs are judged.
    """
    stated, values, own = model.split.tolerances, model.state.beta, model.state.covariance
    if not np.isfinite(own).all() or (stated is None and covariance is not None):
        return values, own if covariance is None else covariance
    candidates = () if stated is None else nuisance_candidates(model.problem, stated)
    scores = score_train(model, candidates)
    free = np.diag(own) > 0.0
    if covariance is None:
        by_run = RunScores(tuple(model.split.names[i] for i in model.split.train),
                           tuple(one.of(np.arange(free.size)) for one in scores))
        covariance = agreement_of(by_run, values, own, free)[0]
    found = None if stated is None else marginalised(
        model, scores, candidates, nuisances_of(candidates, model.problem, stated))
    if found is None:
        return values, covariance
    wide = np.zeros((free.size, free.size))
    directions, further = found.marginal.directions, found.further[: free.size]
    wide[np.ix_(free, free)] = found.marginal.noise + directions.T @ directions
    return values + found.step[: free.size], np.asarray(covariance + wide + np.outer(further, further) / 3.0)


def marginalised(model: Model, scores: Sequence[Score], candidates: Sequence[Candidate],
                 nuisances: Sequence[Nuisance]) -> Tolerated | None:
    """The `nuisances` (k,) of the `candidates` marginalised, by their `scores`, one a train run.

    Of a size n that is `taken` off the readings already, the prior has the score -n / t^2.
    """
    mechanism, free, whole = model.split.mechanism, np.diag(model.state.covariance) > 0.0, total(scores)
    powers = [np.ones(mechanism.p), *(np.array([*(torque_power(s.unit) for s in e.sizes), *(0.0 for _ in e.shapes)])
                                      for e in model.effects)]
    taken = [size for one in candidates for size in model.taken_of(one.effect)[: len(one.effect.sizes)]]
    prior = [size and size / own.tolerance**2 for size, own in zip(taken, nuisances, strict=True)]
    whole = Score(whole.score - np.append(np.zeros(free.size), prior), whole.information)
    return tolerated([whole, *scores], (free, None), nuisances, model.state.beta * np.concatenate(powers), mechanism,
                     model.split.tolerances or {})


def within_tolerance(model: Model, sizes: Sequence[FloatArray]) -> frozenset[str]:
    """Keys of the effects of a model whose `sizes` the tolerances of the rig hold."""
    stated = model.split.tolerances
    return frozenset() if stated is None else frozenset(
        effect.key for effect, size in zip(model.effects, sizes, strict=True)
        if all(abs(value) <= BEYOND * one.tolerance for value, one in zip(size, nuisances_of(
            [Candidate(effect, tuple(size[len(effect.sizes) :]))], model.problem, stated))))
