"""`predict_filtered`: free runs from filtered motion, which is of no model, so that models can be compared from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimator.free_runs.fitted_model import FittedModel
from estimator.free_runs.predicted_run import predict_run
from estimator.free_runs.smoothed_run import SmoothedRun
from estimator.free_runs.table import PredictionTable, tabulate
from estimator.likelihood import Latents, State
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals import Kinematics, SignalSet, by_run, differentiate

CUTOFF_HZ, OF_RATE = 10.0, 0.2
"""Low pass of the filter, and the most of it as a share of the sample rate."""


def predict_filtered(models: Sequence[FittedModel], signals: Sequence[SignalSet], options: FitOptions, horizon_s: float,
                     *, each_piece: bool = False) -> PredictionTable:
    """Table of free-run errors of `models` over pieces of `horizon_s`, each started from filtered motion.

    It favours none of the models. `signals` are the segments of all runs; `each_piece`: see `tabulate`.
    """
    runs = [predict_run(filtered(models, name, segments, options), (horizon_s,))
            for name, segments, _ in by_run(signals)]
    return tabulate(runs, 0, every_horizon=each_piece, each_piece=each_piece)


def filtered(models: Sequence[FittedModel], run: str, signals: Sequence[SignalSet], options: FitOptions
             ) -> list[SmoothedRun]:
    """Motion of one run by filtered differences, with the parameters of each model."""
    motions = filtered_motion(signals, models[0].mechanism, options)
    q, v = np.concatenate([k.q for k in motions]), np.concatenate([k.qd for k in motions])
    problems = [model.problem(signals) for model in models]
    noise = problems[0].shown
    return [SmoothedRun(run, tuple(signals), problem, State(
        Latents(q, v, problem.torque.copy()), model.parameters, noise, np.zeros((model.parameters.size,) * 2)))
        for model, problem in zip(models, problems)]


def filtered_motion(signals: Sequence[SignalSet], mechanism: Mechanism, options: FitOptions) -> list[Kinematics]:
    """Angles and rates of each segment by filtered differences."""
    return [differentiate(s, mechanism, min(CUTOFF_HZ, OF_RATE * s.rate_hz), options.filter_order, fused=True)
            for s in signals]
