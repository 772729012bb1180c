"""Errors of free runs on the train runs, each predicted by a fit to the others: by them a search stops and chooses."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import reduce

import numpy as np

from daq import FloatArray
from estimator.diagnosis.context import DiagnosisContext, with_generic
from estimator.diagnosis.decision_rule import SURE
from estimator.diagnosis.error_table import ErrorTable, floors_of, judged
from estimator.diagnosis.explanation import Explanation
from estimator.diagnosis.model import Model, predicted_left_out, score_train
from estimator.diagnosis.noise_floor import noise_floor
from estimator.errors import FitError
from estimator.parallel import parallel_map
from estimator.prediction import FloorNoise, PredictedRun, together
from estimator.score import Score

Floor = tuple[Model, list[FloatArray]]
"""A model, and (H, C) what noise alone leaves in its free runs, by train run."""


def floor_of_best(context: DiagnosisContext, best: Sequence[Explanation]) -> Floor:
    """The floor of the first of `best` that can be simulated, else of the nominal model, with the noise that it has
    with generic terms: a wrong effect counts what it leaves as a disturbance. Raises `FitError` where none can."""
    for one in best:
        with suppress(FitError):
            return _floor(context, one.model, with_generic(context, one))
    return _floor(context, context.nominal, context.nominal)


def _floor(context: DiagnosisContext, unit: Model, extended: Model) -> Floor:
    return unit, unit.once("floor", lambda: floors_of(unit, noise_of(extended), context.rng))


def noise_of(model: Model) -> FloorNoise:
    """`noise_floor` of a model."""
    return model.once("noise", lambda: noise_floor(model))


def train_table(context: DiagnosisContext, explanations: Sequence[Explanation], floor: Floor | None = None
                ) -> ErrorTable:
    """Errors of the nominal model and of `explanations`, in this order, on the train runs, in units of the `floor`, by
    default that of the best.

    Each run is predicted by the fit to the other train runs. Raises `FitError`.
    """
    (unit, floors), train = floor or floor_of_best(context, explanations), context.split.train
    every = [left_out_runs(context.nominal, context.own_scores, train),
             *(left_out_runs(e.model, e.scores, train) for e in explanations)]
    runs = [reduce(together, [one[run] for one in every]) for run in train]
    return judged(unit, runs, floors, range(len(every)), context.rng)


def surely_errs_less(model: Model, than: Model, rng: np.random.Generator) -> bool:
    """Whether free runs of the train runs, each predicted by a fit to the others, surely err less by `model`.

    The unit of each sensor and horizon is the lesser error of both. Raises `FitError`.
    """
    train = model.split.train
    one, other = (left_out_runs(m, (), train) for m in (model, than))
    table = judged(model, [together(one[run], other[run]) for run in train], [np.full(1, np.inf)], range(2), rng)
    return table.lowers(0, 1, 0.0, 1) >= SURE


def left_out_runs(model: Model, scores: Sequence[Score], runs: Sequence[int]) -> dict[int, PredictedRun]:
    """Each of these train `runs` as predicted by the fit of `model` without its fold; each fold once."""
    known = model.once("left out", dict[int, PredictedRun])
    missing = [fold for fold in model.split.inner if set(fold) & set(runs) and not set(fold) <= known.keys()]
    own = scores if scores or not missing else score_train(model, ())
    for found in parallel_map(lambda k: predicted_left_out(model, own, missing[k]), len(missing),
                              model.split.workers):
        known |= found
    return known
