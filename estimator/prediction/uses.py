"""`uses_of`: what a model is good for, by its errors on data that it was not fitted to.

- feedforward: rms error of the model's torque over the rms of the measured one, at the joints with a motor, along the
  smoothed motion.
- simulation: rms error of free runs over a horizon, over encoders and gyros, in units of each sensor's spread in all of
  the runs. The horizon is the longest over which the error is surely at most ENOUGH.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import get_args

import numpy as np

from daq import FloatArray
from estimator.free_runs import (
    SHORT_S,
    FittedModel,
    PredictionTable,
    measured_use,
    on_one_more,
    predict_run,
    tabulate,
)
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.prediction.smoothing import smooth_segments
from estimator.result import FitResult
from estimator.signals import LEAST_SEGMENT, SignalSet, cut
from estimator.use import Speed, TorqueError, Use, best_first

USE_HORIZONS_S = (0.1, SHORT_S, 5.0, np.inf)


def uses_of(table: PredictionTable, mechanism: Mechanism, model: int = 0) -> tuple[Use, ...]:
    """Uses of a model of `table` by its runs `held`, the supported ones first."""
    weights = table.samples.max(axis=1)
    found = [_simulation(table, h, model, weights) for h in table.horizons_s]
    enough = [one for one in found if one.supported]
    short = table.horizons_s.index(SHORT_S) if SHORT_S in table.horizons_s else -1
    uses = [enough[-1] if enough else found[short]]
    if driven := list(mechanism.actuated):
        by_speed = tuple(one for j in driven for one in _torque_errors(table, model, j, mechanism.force_unit))
        uses.append(replace(measured_use("feedforward", *table.torques(model, driven), table.run, held=table.held),
                            by_speed=by_speed))
    return best_first(uses)


def _torque_errors(table: PredictionTable, model: int, joint: int, unit: str) -> Iterator[TorqueError]:
    for speed, errors, counts in zip(get_args(Speed), *table.torques_by_speed(model, joint)):
        there = counts > 0.0
        rms, ci95 = on_one_more(errors[there], counts[there], table.run[there], table.held)
        if np.isfinite(rms):
            yield TorqueError(joint + 1, speed, rms, unit, ci95)


def _simulation(table: PredictionTable, horizon_s: float, model: int, weights: FloatArray) -> Use:
    longest = min(one.longest_s for one in table.runs)
    return measured_use("simulation", table.by_block(horizon_s)[model] * weights, weights, table.run,
                        horizon_s if np.isfinite(horizon_s) else longest, table.held)


def predict_left_out(result: FitResult, signals: Sequence[SignalSet], options: FitOptions) -> PredictionTable | None:
    """Free runs over each part of the data by the fit without it, from that model's own smoothed motion.

    None where the fit has no such parts, or other samples than `signals`. Raises `FitError` where no motion can be
    estimated.
    """
    ends = np.cumsum([s.time_s.size for s in signals])
    if not result.left_out or ends[-1] != sum(path.time_s.size for path in result.trajectories):
        return None
    runs = []
    for part in result.left_out:
        wanted = [(s, max(part.where.start, int(end) - s.time_s.size), min(part.where.stop, int(end)), int(end))
                  for s, end in zip(signals, ends)]
        wanted = [one for one in wanted if one[2] - one[1] >= min(LEAST_SEGMENT, one[0].time_s.size)]
        if not wanted:
            continue
        own = [cut(s, slice(begin - end + s.time_s.size, stop - end + s.time_s.size)) for s, begin, stop, end in wanted]
        model = FittedModel(result.mechanism, result.hold, part.beta)
        runs.append(predict_run([smooth_segments(model, own[0].run, own, options, 0.0)], USE_HORIZONS_S))
    return tabulate(runs, 0) if runs else None
