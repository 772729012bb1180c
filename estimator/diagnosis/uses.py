"""`with_uses`: what the model of a diagnosis is good for, by its test runs and the scatter of all runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.diagnosis.model import Model
from estimator.diagnosis.result import Diagnosis
from estimator.fit_errors import FIT_ERRORS
from estimator.free_runs import FittedModel
from estimator.parallel import parallel_map
from estimator.prediction import USE_HORIZONS_S, PredictedRun, predict_run, smooth_segments, tabulate, uses_of
from estimator.result import TWO_SIDED
from estimator.use import best_first, use_of_parameters


def model_told(diagnosis: Diagnosis, nominal: Model) -> FittedModel:
    """The model that a model file has: with the named causes, or the nominal one where none is."""
    return replace(nominal.fitted, parameters=diagnosis.extended_beta if diagnosis.effects
                   else np.array([diagnosis.nominal[name] for name in nominal.split.mechanism.names]),
                   effects=tuple(effect for effect, _ in diagnosis.effects), covariance=None, noise=None)


def with_uses(diagnosis: Diagnosis, nominal: Model) -> Diagnosis:
    """`diagnosis` with the uses of its model, those of learnt torques by runs left out; without any where it cannot be
    simulated."""
    split, model = nominal.split, model_told(diagnosis, nominal)
    options = replace(split.options, noise=split.known)

    runs = *split.test, *split.train

    def predicted(k: int) -> PredictedRun:
        run = runs[k]
        one = smooth_segments(model, split.names[run], split.runs[run], options, split.starts_s[run])
        return predict_run([one], USE_HORIZONS_S)

    try:
        if diagnosis.structure is None:
            table = tabulate(parallel_map(predicted, len(runs), split.workers), 0)
            uses = uses_of(replace(table, held=np.arange(len(split.test))), split.mechanism)
        else:
            uses = uses_of(diagnosis.structure.table, split.mechanism, 1)
    except FIT_ERRORS:
        return diagnosis
    values, std = diagnosis.extended or diagnosis.nominal, diagnosis.extended_std or diagnosis.nominal_std
    known = [use_of_parameters(TWO_SIDED * std[p.name], values[p.name], diagnosis.verdict in ("none", "named"))
             for p in split.mechanism.parameters if p.rigid and values.get(p.name) and p.name in std]
    return replace(diagnosis, uses=best_first((*uses, *known[:1])))
