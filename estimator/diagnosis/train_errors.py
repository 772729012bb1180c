"""Errors of free runs on the train runs, each predicted by a fit to the others: by them a search stops and chooses."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import reduce
from typing import NamedTuple

from daq import FloatArray
from estimator.diagnosis.context import DiagnosisContext, with_generic
from estimator.diagnosis.error_table import ErrorTable, floors_of, judged
from estimator.diagnosis.explanation import Explanation
from estimator.diagnosis.model import Model, predicted_left_out, score_train
from estimator.diagnosis.noise_floor import noise_floor
from estimator.errors import FitError
from estimator.parallel import parallel_map
from estimator.prediction import PredictedRun, together
from estimator.score import Score


class TrainFloor(NamedTuple):
    """Errors that noise alone leaves in the free runs of one model on some train runs."""

    unit: Model
    runs: tuple[int, ...]
    floors: list[FloatArray]


def floor_of_best(context: DiagnosisContext, best: Sequence[Explanation], runs: tuple[int, ...]) -> TrainFloor:
    """The floor on these train `runs` of the first of `best` that can be simulated, else of the nominal model, with the
    noise that it has with generic terms: a wrong effect counts what it leaves as a disturbance. Raises `FitError` where
    none can."""
    for one in best:
        with suppress(FitError):
            noise = noise_floor(with_generic(context, one))
            return TrainFloor(one.model, runs, floors_of(one.model, runs, noise, context.rng))
    nominal = context.nominal
    return TrainFloor(nominal, runs, floors_of(nominal, runs, noise_floor(nominal), context.rng))


def train_table(context: DiagnosisContext, found: Sequence[Explanation], floor: TrainFloor) -> ErrorTable:
    """Errors of the nominal model and of `found`, in this order, on the runs of the `floor`, in its units.

    Each run is predicted by the fit to the other train runs. Raises `FitError`.
    """
    every = [left_out_runs(context, context.nominal, context.own_scores, floor.runs),
             *(left_out_runs(context, e.model, e.scores, floor.runs) for e in found)]
    runs = [reduce(together, [one[run] for one in every]) for run in floor.runs]
    return judged(floor.unit, runs, floor.floors, range(len(every)), context.rng)


def left_out_runs(context: DiagnosisContext, model: Model, scores: Sequence[Score], runs: Sequence[int]
                  ) -> dict[int, PredictedRun]:
    """Each of these train `runs` as predicted by the fit of `model` without its fold; each fold once."""
    known = next((found for one, found in context.left_out if one is model), None)
    if known is None:
        known = {}
        context.left_out.append((model, known))
    missing = [fold for fold in context.split.inner if set(fold) & set(runs) and not set(fold) <= known.keys()]
    own = scores if scores or not missing else score_train(model, ())
    for found in parallel_map(lambda k: predicted_left_out(model, own, missing[k]), len(missing),
                              context.split.workers):
        known |= found
    return known
