"""`ErrorTable`: free-run errors of several models in units of what noise alone leaves, as a verdict reads them.

The errors are those of `estimator.prediction`, over pieces of `DECIDING_S`. In units of what noise alone leaves in a
replicate of the same pieces they are comparable over sensors and horizons; their mean over all of them is the error of
a model. Each squared error is capped at the variance of its sensor. The smoother holds the noise of each fit, so that
all explanations have the same weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil

import numpy as np

from daq import FloatArray, IndexArray
from estimator.diagnosis.decision_rule import DECIDING_S, DRAWS, WHOLE_RUNS
from estimator.diagnosis.model import Model, smooth
from estimator.parallel import parallel_map
from estimator.prediction import (
    FloorNoise,
    PredictedRun,
    SmoothedRun,
    channel_names,
    floor_errors,
    predict_run,
    tabulate,
)

NOMINAL = 0
"""Row of the nominal model."""


@dataclass(frozen=True)
class ErrorTable:
    """Squared free-run errors of M models over B blocks of R runs, in K columns."""

    columns: tuple[tuple[str, float], ...]
    """(K,) sensor column and horizon [s]"""
    values: FloatArray
    """(M, B, K) mean over a block, at most the column's bound, in units of what noise alone leaves in that column"""
    agreement: FloatArray
    """(M, R) fall of -2 log likelihood of each run from the first model to this one, both under one noise"""
    runs: IndexArray
    """(B,) the run that each block belongs to, counted from 0"""
    draws: IndexArray
    """(D, B) blocks of resampled runs"""
    floor: FloatArray
    """(K,) mean squared error that noise alone leaves in each column"""
    bound: FloatArray
    """(K,) variance of each column's sensor over these runs: who knows nothing of the leg errs by it"""

    def error(self, model: int, blocks: IndexArray | None = None) -> float:
        """Root mean square of a model's error over all columns, inf where it is no number; 1 is noise alone."""
        return float(self._whole[model] if blocks is None else self.errors(model, blocks))

    def errors(self, model: int | slice, draws: IndexArray) -> FloatArray:
        """(...) the same for each draw of blocks (..., B)."""
        found = np.sqrt(self.values[model].mean(axis=-1)[..., draws].mean(axis=-1))
        return np.where(np.isfinite(found), found, np.inf)

    @cached_property
    def _whole(self) -> FloatArray:
        """(M,) error of each model over all blocks."""
        return self.errors(slice(None), np.arange(self.values.shape[1]))

    def excess(self, model: int, blocks: IndexArray | None = None) -> float:
        """Mean square beyond noise alone."""
        return max(self.error(model, blocks) ** 2 - 1.0, 0.0)

    def lowers(self, model: int, than: int, by: float, of: int) -> float:
        """Share of resamplings in which error(than) - error(model) > by * error(of).

        All three errors are of the same resampling, because one diverging piece can be most of the error.
        """
        draws = self.draws
        with np.errstate(invalid="ignore"):  # of two that diverge neither errs less
            return float(np.mean(self.errors(than, draws) - self.errors(model, draws) > by * self.errors(of, draws)))

    def falls(self, model: int, than: int, by: float, of: int | None = None) -> bool:
        """Whether error(than) - error(model) > by * error(of); `of` is by default `than`."""
        return self.error(than) - self.error(model) > by * self.error(than if of is None else of)

    def raises(self, model: int, than: int, by: float, of: int) -> bool:
        """Whether any run's error is more with `model` than with `than` by the share `by` of that of the model `of`
        over all runs: a run that hardly errs may err a little more."""
        each = [np.flatnonzero(self.runs == k) for k in np.unique(self.runs)]
        return any(self.error(model, d) - self.error(than, d) > by * self.error(of) for d in each)

    def likelier(self, model: int, than: int) -> bool:
        """Whether the runs together are likelier with `model`."""
        return bool(self.agreement[model].sum() > self.agreement[than].sum())

    def resampled(self, draw: int) -> ErrorTable:
        """The table on one resampling of its blocks."""
        blocks, whole = self.draws[draw], np.arange(self.values.shape[1])[None]
        return replace(self, values=self.values[:, blocks], runs=self.runs[blocks], draws=whole)


def measure(models: Sequence[Model], unit: int, noise: FloorNoise, rng: np.random.Generator,
            smoothers: Sequence[int]) -> ErrorTable:
    """Errors of `models`, the nominal one first, on the test runs of their split.

    Units are what `noise` leaves of model `unit`. The smoother of the likeliest of `smoothers` supplies an angle that
    no sensor reads. Raises `FitError` where the simulation of `unit` diverges.
    """
    split = models[NOMINAL].split
    seeds = rng.integers(2**63, size=len(split.test))

    def measured(k: int) -> tuple[PredictedRun, FloatArray]:
        fitted = [smooth(model, split.test[k]) for model in models]
        floor = floor_of(models[unit], split.test[k], fitted[unit], seeds[k], DECIDING_S, noise,
                         len(seeds)).mean(axis=-1)
        found = predict_run(fitted, DECIDING_S)
        return replace(found, misfits=np.array([one.misfit(models[unit].state.noise) for one in fitted])), floor

    parts = parallel_map(measured, len(split.test), split.workers)
    return judged(models[unit], [run for run, _ in parts], [floor for _, floor in parts], smoothers, rng)


def floors_of(unit: Model, noise: FloorNoise, rng: np.random.Generator) -> list[FloatArray]:
    """(H, C) what `noise` leaves of model `unit` in each train run. Raises `FitError` where that diverges."""
    runs = unit.split.train
    seeds = rng.integers(2**63, size=len(runs))

    def left(k: int) -> FloatArray:
        return floor_of(unit, runs[k], smooth(unit, runs[k]), seeds[k], DECIDING_S, noise, len(runs)).mean(axis=-1)

    return parallel_map(left, len(runs), unit.split.workers)


def judged(unit: Model, runs: Sequence[PredictedRun], floors: Sequence[FloatArray], smoothers: Sequence[int],
           rng: np.random.Generator) -> ErrorTable:
    """The table of predicted `runs` with what noise leaves in runs like them, `floors` (H, C) each."""
    horizons = runs[0].horizons_s
    misfits = np.stack([run.misfits for run in runs], axis=-1)
    smoother = min(smoothers, key=lambda k: float(misfits[k].sum()))
    table = tabulate(runs, smoother, about_mean=True, every_horizon=True)
    sensors = sensors_of(unit)
    which = [table.channels.index(sensor) for sensor in sensors]
    squares = np.swapaxes(table.capped[:, :, which], 2, 3)  # (M, B, H, C)
    squares, bound = squares.reshape(*squares.shape[:2], -1), np.tile(table.variance[which], len(horizons))
    # noise leaves no more than a model of the same runs errs
    floor = np.fmin(np.mean(floors, axis=0).ravel(), np.fmin.reduce(squares.mean(axis=1)))
    columns = tuple((sensor, horizon) for horizon in horizons for sensor in sensors)
    count = squares.shape[1]
    return ErrorTable(columns, squares / floor, misfits[NOMINAL] - misfits, table.run,
                      rng.integers(0, count, (DRAWS, count), dtype=np.intp), floor, bound)


def spread_out(table: ErrorTable, rows: Sequence[int], count: int) -> ErrorTable:
    """`table` with its models in these `rows` of `count`; NaN in all others."""
    values, agreement = (np.full((count, *of.shape[1:]), np.nan) for of in (table.values, table.agreement))
    values[list(rows)], agreement[list(rows)] = table.values, table.agreement
    return replace(table, values=values, agreement=agreement)


def joined(tables: Sequence[ErrorTable], rng: np.random.Generator) -> ErrorTable:
    """One table of the same models over the runs of several, each in units of its own."""
    first = np.cumsum([0, *(t.agreement.shape[1] for t in tables[:-1])])
    values = np.concatenate([t.values for t in tables], axis=1)
    count = values.shape[1]
    return replace(tables[0], values=values, agreement=np.concatenate([t.agreement for t in tables], axis=1),
                   runs=np.concatenate([t.runs + n for t, n in zip(tables, first)]),
                   draws=rng.integers(0, count, (DRAWS, count), dtype=np.intp))


def sensors_of(model: Model) -> tuple[str, ...]:
    """Channels whose errors count, alphabetically: encoders, IMUs, and the pivot's angle where an IMU stands in for
    its encoder."""
    problem, names = model.problem, channel_names(model.problem)
    read = problem.has_encoder | (model.split.has_imu & (np.arange(problem.n) == 0))
    return tuple(sorted([*(c for c, own in zip(names, read) if own), *names[2 * problem.n :]]))


def floor_of(model: Model, run: int, fitted: SmoothedRun, seed: int | np.int64, horizons_s: Sequence[float],
             noise: FloorNoise, count: int) -> FloatArray:
    """(H, C, N) squared errors of replicates with this `noise` alone, of the run as `fitted`, in `sensors_of`.

    The run is one of `count`. Errors over whole runs are a mean of WHOLE_RUNS replicates of all of them: a leg that
    sticks leaves ten times as much in one as in another. The error of a pivot's angle without an encoder is about its
    mean, as in `tabulate`.
    """
    rng = np.random.default_rng(seed)
    rows, whole = [channel_names(fitted.problem).index(c) for c in sensors_of(model)], np.isinf(horizons_s)
    unread = [k for k, row in enumerate(rows) if row < model.problem.n and not model.problem.has_encoder[row]]

    def drawn(horizons_s: Sequence[float]) -> FloatArray:
        found = floor_errors(fitted, rng, horizons_s, lambda signals: model.on(run, signals=signals),
                             noise)[:, rows]
        found[:, unread] -= found[:, unread].mean(axis=-1, keepdims=True)
        return found**2

    squares = drawn(horizons_s)
    if whole.any():
        more = ceil(WHOLE_RUNS / count) - 1
        squares[whole] = np.mean([squares[whole], *(drawn([np.inf]) for _ in range(more))], axis=0)
    return squares
