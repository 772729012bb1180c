"""`with_tolerances`: the covariance of a diagnosis' model with what may be wrong with the rig, as a fit's has it."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.diagnosis.model import Model, score_train
from estimator.fitting import tolerated
from estimator.score import RunScores, agreement_of, nuisance_candidates, nuisances_of, torque_power, total


def with_tolerances(model: Model, covariance: FloatArray | None = None) -> FloatArray:
    """(w, w) `covariance` of the leg's parameters and sizes with the tolerances of the rig marginalised.

    By default that of noise and of what the train runs disagree about.

    A named effect has no tolerance: its size is estimated. The values stay at the model's optimum, so the whole step
    to the likeliest nuisances counts with a rectangular distribution (JCGM 100, 4.3.7).
    """
    stated, mechanism = model.split.options.tolerances, model.split.mechanism
    leg = model.state.covariance[: model.width, : model.width]
    if not np.isfinite(model.state.covariance).all():
        return leg if covariance is None else covariance
    candidates = () if stated is None else nuisance_candidates(model.problem, (), stated)
    scores = score_train(model, candidates)
    free = np.diag(model.state.covariance) > 0.0
    if covariance is None:
        names = tuple(model.split.names[i] for i in model.split.train)
        own = RunScores(names, tuple(one.of(np.arange(free.size)) for one in scores))
        covariance = agreement_of(own, model.state.beta, leg, free)[0]
    if stated is None:
        return covariance
    powers = [np.ones(mechanism.p), *(np.array([*(torque_power(s.unit) for s in e.sizes), *(0.0 for _ in e.shapes)])
                                      for e in model.effects)]
    nuisances = nuisances_of(candidates, model.problem, stated)
    found = tolerated([total(scores), *scores], (free, None), nuisances, model.state.beta * np.concatenate(powers),
                      mechanism, stated, np.zeros(len(nuisances)))
    if found is None:
        return covariance
    wide = np.zeros((free.size, free.size))
    own = np.flatnonzero(free)
    directions = found.marginal.directions
    wide[np.ix_(own, own)] = found.marginal.noise + directions.T @ directions
    step = 2.0 * found.step[: free.size]
    wide += np.outer(step, step) / 3.0
    return covariance + wide[: model.width, : model.width]
