"""`predict`: the table of free-run errors of models on runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from daq import Dataset
from estimator.free_runs import (
    HORIZONS_S,
    FittedModel,
    PredictedRun,
    PredictionTable,
    SmoothedRun,
    predict_run,
    tabulate,
)
from estimator.options import FitOptions
from estimator.prediction.smoothing import smooth


def predict(models: Sequence[FittedModel], runs: Iterable[Dataset], options: FitOptions,
            horizons_s: Iterable[float] = HORIZONS_S, smoother: int | None = None,
            seen: Callable[[Dataset, Sequence[SmoothedRun]], None] = lambda data, smoothed: None) -> PredictionTable:
    """Free-run errors of `models` on `runs`, given in the order in which they were recorded.

    Each run is smoothed once a model. Session time, on which friction that drifts depends, begins at the first run.
    `smoother`: see `tabulate`; where one is given the densities of the runs are left out. `seen` is told of each run's
    smoothed motions. Raises `FitError` where no motion can be estimated.
    """
    found: list[PredictedRun] = []
    session_s = 0.0
    for data in runs:
        smoothed = [smooth(model, data, options, session_s) for model in models]
        found.append(predict_run(smoothed, with_whole(horizons_s), data, smoother is None))
        session_s += smoothed[0].problem.total * smoothed[0].problem.dt
        seen(data, smoothed)
    return tabulate(found, smoother)


def with_whole(horizons_s: Iterable[float]) -> tuple[float, ...]:
    """Rising, each once, the whole segment last."""
    return tuple(sorted({*map(float, horizons_s), np.inf}))
