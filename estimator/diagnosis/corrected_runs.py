"""`corrected`: the runs of a diagnosis without the small faults that the tolerances of the rig's sensors allow.

The scores of the train runs say how large these are (`estimator.score.SensorFaults`). They are taken off the readings
of all runs. Where something larger is wrong they stay, and are faults to be named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimator.diagnosis.context import DiagnosisContext
from estimator.diagnosis.data_split import RunSplit
from estimator.diagnosis.model import Model, nearby, nominal_model, refit, run_states, score_train, smooth
from estimator.errors import FIT_ERRORS
from estimator.fitting import SmallFault, small_faults, without_faults
from estimator.score import BEYOND, Score, SensorFaults
from estimator.signals import SignalSet

PASSES = 3
"""Most passes: each takes off what the one before, linear, has left."""
CLOSE = 0.1
"""Of a tolerance: a smaller step is the last."""


class Corrected(NamedTuple):
    """Runs with what was taken off their readings, and their nominal model."""

    nominal: Model
    faults: tuple[SmallFault, ...]


def corrected(context: DiagnosisContext, model: Model, scores: Sequence[Score]) -> Corrected | None:
    """The runs of `context` without small faults; `scores` (R,) are those of its candidates at `model`.

    None where nothing is to be taken off, or where something is wrong that tolerances do not hold.
    """
    stated = context.split.options.tolerances
    if stated is None or not np.isfinite(model.state.covariance).all():
        return None
    free = np.diag(model.state.covariance) > 0.0
    sensors = SensorFaults.of(context.candidates, model.problem, free, stated).chosen(scores, context.least_gain)
    if sensors is None:
        return None
    taken, nominal = np.zeros(len(sensors.sizes)), model
    for _ in range(PASSES):
        step = sensors.likeliest(scores, taken).sizes
        if np.any(np.abs(taken + step) > BEYOND * sensors.tolerances):
            return None
        if not np.any(np.abs(step) > CLOSE * sensors.tolerances):
            break
        taken = taken + step
        try:
            nominal = nominal_model(without(model, small_faults(sensors, step)), nearby(nominal))
            model = refit(nominal, list(zip(model.effects, model.sizes()))) if model.effects else nominal
        except FIT_ERRORS:
            return None
        scores = unbiased(context, model, score_train(model, context.candidates))
    return Corrected(nominal, tuple(small_faults(sensors, taken))) if taken.any() else None


def unbiased(context: DiagnosisContext, model: Model, scores: Sequence[Score]) -> list[Score]:
    """`scores` (R,) of a model less what they are in replicates of the nominal one."""
    p = model.problem.mechanism.p
    own = [p] * (model.problem.parameter_count - p)
    return [replace(one, score=one.score - np.insert(bias, own, 0.0))
            for one, bias in zip(scores, context.bias, strict=True)]


def without(model: Model, faults: Sequence[SmallFault]) -> RunSplit:
    """The split of `model` without what the `faults` add at the motion of each run; stiction is found anew."""
    split, states = model.split, dict(zip(model.split.train, run_states(model), strict=True))
    runs: list[tuple[SignalSet, ...]] = []
    for i, own in enumerate(split.runs):
        if i in states:
            problem, state = model.on(i), states[i]
        else:
            one = smooth(model, i)
            problem, state = one.problem, one.state
        runs.append(tuple(without_faults(own, problem, state, faults)))
    return replace(split, runs=tuple(runs), stiction={})
