"""Free-run errors of one session's runs under the reference model, and whether another session's are larger.

Scores ask which listed change is likely. This asks nothing of a list: a model of an unchanged rig predicts later runs
as well as it predicts a reference run that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import Dataset, FloatArray
from estimator.change.noise import LogLevels, compare_noise
from estimator.change.result import LevelChange
from estimator.change.scores import ReferenceFit
from estimator.errors import FitError
from estimator.fit_errors import FIT_ERRORS
from estimator.prediction import SHORT_S, predict_run, smooth, tabulate
from estimator.score import Score, step_without


def error_levels(fit: ReferenceFit, runs: Sequence[Dataset], scores: Sequence[Score] = ()) -> LogLevels:
    """Mean and variance over the runs of the log rms error of each angle and rate that a sensor reads.

    Free runs take `SHORT_S`. There is no level where a run cannot be simulated. With the `scores` of the runs that were
    fitted each run is predicted by the others: the fit without it is one Newton step away.
    """
    found: dict[str, list[float]] = {}
    for k, run in enumerate(runs):
        try:
            errors = free_run_errors(fit, run, _without(fit, scores, k) if scores else fit.model.beta)
        except FIT_ERRORS:
            return LogLevels(len(runs), {})
        for name, error in errors.items():
            found.setdefault(name, []).append(error)
    return LogLevels.of(len(runs), {name: values for name, values in found.items()
                                    if len(values) == len(runs) and max(values) < np.inf})


def free_run_errors(fit: ReferenceFit, run: Dataset, beta: FloatArray) -> dict[str, float]:
    """Channel to its rms error over free runs of `SHORT_S` with the parameters `beta` (p,). Raises `FitError`."""
    model = replace(fit.model, parameters=beta)
    table = tabulate([predict_run([smooth(model, run, fit.options)], [SHORT_S])])
    return {name: table.rms(0, name, SHORT_S) for name in table.judged}


def larger_error(test: LogLevels, reference: LogLevels, comparisons: int = 1) -> LevelChange | None:
    """The likeliest rise of an error, its p-value one-sided, over all channels and `comparisons`; None where none rose.

    Raises `FitError` if no channel can be compared.
    """
    found = compare_noise(test, reference)
    if not found:
        raise FitError("the free runs cannot be compared: some run cannot be simulated, or the reference file was "
                       "written without errors of free runs")
    risen = [one for one in found if one.ratio > 1.0]
    return replace(risen[0], p_value=min(1.0, 0.5 * comparisons * risen[0].p_value)) if risen else None


def _without(fit: ReferenceFit, scores: Sequence[Score], k: int) -> FloatArray:
    """(p,) parameters of the fit to all runs but the k-th; a friction at its bound of zero stays there."""
    beta: FloatArray = fit.model.beta
    return beta + step_without(scores, fit.free & (beta != 0.0), (k,))
