"""Free-run errors of several models on held-out runs.

A free run starts from the fitted motion and is driven by the measured torque alone, over pieces of `DECIDING_S`. Its
squared errors, in units of what noise alone leaves in a replicate of the same piece, are comparable over channels and
horizons; their mean over all of them is the error of a model. Where no encoder measures the pivot's angle, it is what
the model reads out of the sensors under which these runs are likeliest. Its zero is no reading: two models read the
IMU's some milliradians apart, and nothing moves by that. So the run's mean error of that angle does not count.

The smoother holds the noise of the nominal fit, so that all explanations have the same weights. Errors of a sensor that
a user reads are those of `estimator.prediction` (see `gain.measure_gain`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.diagnosis.decision_rule import DECIDING_S, DRAWS, WHOLE_RUNS
from estimator.diagnosis.refit import Model, smooth
from estimator.parallel import parallel_map
from estimator.prediction import (
    BLOCK_S,
    FloorNoise,
    SmoothedRun,
    channel_names,
    floor_errors,
    predict_run,
    white_noise,
)


@dataclass(frozen=True)
class Unit:
    """Unit of the errors: the noise floor of one model; and the values taken as measured."""

    reference: Model
    noise: FloorNoise
    """Under which its replicates are drawn"""
    floor: FloatArray
    """(C,) mean squared error that noise alone leaves in each column"""
    smoother: Model
    """The one that reads the pivot's angle, and ..."""
    pivots: tuple[FloatArray, ...]
    """... that angle in each run"""
    bound: FloatArray
    """(C,) variance of each column's sensor over these runs: who knows nothing of the leg errs by it"""
    misfits: FloatArray
    """(R,) -2 log likelihood of each run under the nominal model and the noise of the reference"""


@dataclass(frozen=True)
class ErrorTable:
    """Squared free-run errors of several models on held-out runs."""

    columns: tuple[tuple[str, float], ...]
    """(sensor column, horizon [s])"""
    values: FloatArray
    """(M, B, C) mean over a block, at most the column's bound, in units of what noise alone leaves in that column"""
    agreement: FloatArray
    """(M, R) fall of -2 log likelihood of each run from the first model to this one, both under one noise"""
    runs: NDArray[np.intp]
    """(B,) the run that each block belongs to, counted from 0"""
    models: tuple[Model, ...]
    """(M,) whose errors these are; the first is the nominal one"""
    unit: Unit

    def error(self, model: int, blocks: NDArray[np.intp] | None = None) -> float:
        """Root mean square of a model's error over all columns, inf where it is no number; 1 is noise alone."""
        return float(self.errors(model, np.arange(self.values.shape[1]) if blocks is None else blocks))

    def errors(self, model: int, draws: NDArray[np.intp]) -> FloatArray:
        """(...) the same for each draw of blocks (..., B)."""
        found = np.sqrt(self.values[model].mean(axis=-1)[draws].mean(axis=-1))
        return np.where(np.isfinite(found), found, np.inf)

    def excess(self, model: int, blocks: NDArray[np.intp] | None = None) -> float:
        """Mean square beyond noise alone."""
        return max(self.error(model, blocks) ** 2 - 1.0, 0.0)

    def draws(self, rng: np.random.Generator) -> NDArray[np.intp]:
        """(DRAWS, B) blocks of resampled runs."""
        count = self.values.shape[1]
        return rng.integers(0, count, (DRAWS, count), dtype=np.intp)

    def lowers(self, model: int, than: int, by: float, draws: NDArray[np.intp], of: int) -> float:
        """Share of resamplings in which error(than) - error(model) > by * error(of).

        All three errors are of the same resampling, because one diverging piece can be most of the error.
        """
        with np.errstate(invalid="ignore"):  # of two that diverge neither errs less
            return float(np.mean(self.errors(than, draws) - self.errors(model, draws) > by * self.errors(of, draws)))

    def raises(self, model: int, than: int, by: float, of: int) -> bool:
        """Whether any run's error is more with `model` than with `than` by the share `by` of that of the model `of`
        over all runs: a run that hardly errs may err a little more."""
        each = [np.flatnonzero(self.runs == k) for k in np.unique(self.runs)]
        return any(self.error(model, d) - self.error(than, d) > by * self.error(of) for d in each)


class Measured(NamedTuple):
    """Errors of one run."""

    squares: FloatArray
    """(smoothers, M, B, C)"""
    floor: FloatArray
    """(C,)"""
    moments: FloatArray
    """(2, C)"""
    misfits: FloatArray
    """(M,)"""
    pivots: FloatArray
    """(smoothers, N)"""


def measure_errors(models: Sequence[Model], reference: Model, seeds: NDArray[np.int64],
                   smoothers: Sequence[int] | None = None, noise: FloorNoise | None = None) -> ErrorTable:
    """Errors of `models`, the nominal one first, on their confirm runs, in units of the `reference`'s noise floor.

    The floor is of `noise`, by default the reference's own, with one of `seeds` a run. The smoother of one of
    `smoothers`, by default of all models, supplies the pivot angle. Each squared error is capped at the sensor's
    variance. Raises `FitError` where the reference's simulation diverges.
    """
    split = reference.split
    best = next((k for k, m in enumerate(models) if m is reference), len(models))
    every = [*models, *([reference] if best == len(models) else [])]
    could = list(range(len(models)) if smoothers is None else smoothers)
    drawn = noise or white_noise(reference.state.noise)

    def measured(k: int) -> Measured:
        run = split.confirm[k]
        fitted = [smooth(model, run) for model in every]
        pivots = np.stack([fitted[r].state.x.q[:, 0] for r in could])
        floor = floor_of(reference, run, fitted[best], seeds[k], DECIDING_S, drawn).mean(axis=-1).ravel()
        squares, moments = _squares(reference, fitted[: len(models)], pivots)
        return Measured(squares, floor, moments,
                        _misfits(fitted, reference)[: len(models)], pivots)

    parts = parallel_map(measured, len(split.confirm), split.workers)
    lengths = [p.squares.shape[2] for p in parts]
    floor, moments = (np.average(of, axis=0, weights=lengths) for of in ([p.floor for p in parts],
                                                                         [p.moments for p in parts]))
    bound = moments[1] - moments[0] ** 2
    misfits = np.stack([p.misfits for p in parts], axis=-1)
    smoother = int(np.argmin(misfits.sum(axis=1)[could]))
    squares = np.concatenate([p.squares[smoother] for p in parts], axis=1)
    floor = _least(floor, np.minimum(squares, bound))
    unit = Unit(reference, drawn, floor, models[could[smoother]], tuple(p.pivots[smoother] for p in parts), bound,
                misfits[0])
    return ErrorTable(_columns_of(reference), _bounded([squares], floor, bound),
                      misfits[0] - misfits, np.repeat(np.arange(len(parts)), lengths), tuple(models), unit)


def extend_errors(table: ErrorTable, more: Sequence[Model]) -> ErrorTable:
    """`table` with rows for `more` models."""
    split = table.unit.reference.split

    def measured(k: int) -> tuple[FloatArray, FloatArray]:
        fitted = [smooth(model, split.confirm[k]) for model in more]
        reference, pivot = table.unit.reference, table.unit.pivots[k][None]
        return _squares(reference, fitted, pivot)[0][0], table.unit.misfits[k] - _misfits(fitted, reference)

    if not more:
        return table
    parts = parallel_map(measured, len(split.confirm), split.workers)
    values = _bounded([p[0] for p in parts], table.unit.floor, table.unit.bound)
    agreement = np.stack([p[1] for p in parts], axis=-1)
    return replace(table, values=np.concatenate([table.values, values]), models=(*table.models, *more),
                   agreement=np.concatenate([table.agreement, agreement]))


def known_errors(known: Sequence[ErrorTable], models: Sequence[Model]) -> ErrorTable | None:
    """Errors of `models` in units of the second one's noise floor, measured only where no `known` table of that unit
    has them; None without such a table."""
    for table in reversed(known):
        if len(models) > 1 and table.unit.reference is models[1]:
            more = [m for m in models if not any(m is k for k in table.models)]
            place = {id(m): k for k, m in enumerate((*table.models, *more))}
            return choose_rows(extend_errors(table, more), [place[id(m)] for m in models])
    return None


def with_floor(table: ErrorTable, noise: FloorNoise, seeds: NDArray[np.int64]) -> ErrorTable:
    """`table` in units of what this `noise` leaves of its reference, with one of `seeds` a confirm run.

    Raises `FitError`."""
    unit = table.unit
    split = unit.reference.split

    def measured(k: int) -> FloatArray:
        run = split.confirm[k]
        fitted = smooth(unit.reference, run)
        return floor_of(unit.reference, run, fitted, seeds[k], DECIDING_S, noise).mean(axis=-1).ravel()

    parts = parallel_map(measured, len(split.confirm), split.workers)
    lengths = np.bincount(table.runs, minlength=len(parts))
    floor = _least(np.average(parts, axis=0, weights=lengths), table.values * unit.floor)
    return replace(table, values=table.values * (unit.floor / floor), unit=replace(unit, noise=noise, floor=floor))


def _least(floor: FloatArray, squares: FloatArray) -> FloatArray:
    """(C,) the floor, at most the least mean of the models' `squares` (M, B, C).

    Noise leaves no more than a model of the same runs errs.
    """
    return np.asarray(np.fmin(floor, np.fmin.reduce(squares.mean(axis=1))))


def sensors_of(model: Model) -> tuple[str, ...]:
    """Channels whose errors count, alphabetically: encoders, IMUs, and the pivot's angle where an IMU stands in for
    its encoder."""
    problem, names = model.problem, channel_names(model.problem)
    read = problem.has_encoder | (model.split.has_imu & (np.arange(problem.n) == 0))
    return tuple(sorted([*(c for c, own in zip(names, read) if own), *names[2 * problem.n :]]))


def about_zero(model: Model, errors: FloatArray) -> FloatArray:
    """(..., C, N) `errors` in `sensors_of`, that of a pivot's angle without an encoder about its mean over the run."""
    if model.split.has_imu and not model.problem.has_encoder[0]:
        pivot = sensors_of(model).index(channel_names(model.problem)[0])
        errors[..., pivot, :] -= errors[..., pivot, :].mean(axis=-1, keepdims=True)
    return errors


def floor_of(model: Model, run: int, fitted: SmoothedRun, seed: int | np.int64, horizons_s: Sequence[float],
             noise: FloorNoise) -> FloatArray:
    """(H, C, N) squared errors of replicates with this `noise` alone, of the run as `fitted`, in `sensors_of`.

    Those over whole runs are a mean of WHOLE_RUNS replicates: a leg that sticks leaves ten times as much in one as in
    another.
    """
    split, rng = model.split, np.random.default_rng(seed)
    rows, whole = [channel_names(fitted.problem).index(c) for c in sensors_of(model)], np.isinf(horizons_s)

    def drawn(horizons_s: Sequence[float]) -> FloatArray:
        found = floor_errors(fitted, rng, horizons_s, lambda signals: split.problem(
            [run], model.problem.stage.angle_range, model.effects, signals=signals), noise)
        return about_zero(model, found[:, rows]) ** 2

    squares = drawn(horizons_s)
    if whole.any():
        squares[whole] = np.mean([squares[whole], *(drawn([np.inf]) for _ in range(WHOLE_RUNS - 1))], axis=0)
    return squares


def choose_rows(table: ErrorTable, rows: Sequence[int]) -> ErrorTable:
    """`table` with these rows alone, in this order."""
    return replace(table, values=table.values[list(rows)], agreement=table.agreement[list(rows)],
                   models=tuple(table.models[k] for k in rows))


def _columns_of(model: Model) -> tuple[tuple[str, float], ...]:
    """Sensors, alphabetically, at each horizon."""
    return tuple((c, horizon) for horizon in DECIDING_S for c in sensors_of(model))


def _squares(reference: Model, fitted: Sequence[SmoothedRun], pivots: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(P, M, B, C) mean squared errors over blocks of a run, and (2, C) mean and mean square of each column.

    `fitted` are the smoothed runs of the models. An angle without an encoder is each of `pivots` (P, N).
    """
    found = predict_run(fitted, DECIDING_S, misfits=False)
    rows = [found.channels.index(c) for c in sensors_of(reference)]
    size = max(10, int(BLOCK_S * found.rate_hz))
    measured = np.stack([np.where(np.isnan(found.measured[rows]), pivot, found.measured[rows]) for pivot in pivots])
    errors = about_zero(reference, found.simulated[:, :, rows] - measured[:, None, None])
    squares = np.where(np.isnan(errors), np.inf, errors**2)
    parts = np.array_split(squares, max(1, squares.shape[-1] // size), axis=-1)
    means = np.stack([part.mean(axis=-1) for part in parts], axis=2)  # (P, M, B, H, C)
    moments = np.stack([measured[0].mean(axis=-1), np.mean(measured[0] ** 2, axis=-1)])
    return means.reshape(*means.shape[:3], -1), np.tile(moments, len(DECIDING_S))


def _bounded(squares: Sequence[FloatArray], floor: FloatArray, bound: FloatArray) -> FloatArray:
    """(M, B, C) of all runs, each (M, blocks, C), in units of the floor."""
    return np.asarray(np.minimum(np.concatenate(squares, axis=1), bound) / floor)


def _misfits(fitted: Sequence[SmoothedRun], reference: Model) -> FloatArray:
    """(M,) -2 log likelihood up to a constant, all under the noise of the reference."""
    return np.array([one.misfit(reference.state.noise) for one in fitted])
