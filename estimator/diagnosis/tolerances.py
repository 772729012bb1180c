"""`with_tolerances`: a diagnosis' model with what may be wrong with the rig, as a fit has it."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.diagnosis.model import Model, score_train
from estimator.fitting import tolerated
from estimator.score import RunScores, agreement_of, nuisance_candidates, nuisances_of, torque_power, total


def with_tolerances(model: Model, covariance: FloatArray | None = None) -> FloatArray:
    """(w, w) covariance of the leg's parameters and sizes at their optimum, the tolerances of the rig marginalised.

    `covariance` is that of noise and of what the train runs disagree about. The model stays at its optimum, by which
    free runs are judged: the whole step to the likeliest nuisances counts with a rectangular distribution (JCGM 100,
    4.3.7).
    """
    stated, mechanism, width = model.split.options.tolerances, model.split.mechanism, model.width
    leg = model.state.covariance[:width, :width]
    if not np.isfinite(model.state.covariance).all() or (stated is None and covariance is not None):
        return leg if covariance is None else covariance
    candidates = () if stated is None else nuisance_candidates(model.problem, (), stated)
    scores = score_train(model, candidates)
    free = np.diag(model.state.covariance) > 0.0
    if covariance is None:
        by_run = RunScores(tuple(model.split.names[i] for i in model.split.train),
                           tuple(one.of(np.arange(free.size)) for one in scores))
        covariance = agreement_of(by_run, model.state.beta, leg, free)[0]
    if stated is None:
        return covariance
    powers = [np.ones(mechanism.p), *(np.array([*(torque_power(s.unit) for s in e.sizes), *(0.0 for _ in e.shapes)])
                                      for e in model.effects)]
    nuisances = nuisances_of(candidates, model.problem, stated)
    found = tolerated([total(scores), *scores], (free, None), nuisances, model.state.beta * np.concatenate(powers),
                      mechanism, stated)
    if found is None:
        return covariance
    wide = np.zeros((free.size, free.size))
    directions, step = found.marginal.directions, (found.step + found.further)[:width]
    wide[np.ix_(free, free)] = found.marginal.noise + directions.T @ directions
    return np.asarray(covariance + wide[:width, :width] + np.outer(step, step) / 3.0)
