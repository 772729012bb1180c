"""How far free runs of several models are off, on runs that chose nothing.

A free run starts from the fitted motion and is driven by the measured torque alone, over pieces of `HORIZONS_S`. Its
squared errors, in units of what noise alone leaves in a replicate of the same piece, are comparable over channels and
horizons; their mean over all of them is the error of a model. Where no encoder measures the pivot's angle, it is what
the model reads out of the sensors under which these runs are likeliest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.diagnosis.conclusion import PIVOT, floor_errors, resimulate, sensors_of
from estimator.diagnosis.decision_rule import BLOCK_S, DRAWS, HORIZONS_S
from estimator.diagnosis.noise_floor import FloorNoise, white_noise
from estimator.diagnosis.refit import Model, SmoothedRun, smooth
from estimator.parallel import parallel_map


@dataclass(frozen=True)
class Unit:
    """What errors are counted in: the noise alone of one model; and what is taken for measured."""

    reference: Model
    noise: FloorNoise
    """Under which its replicates are drawn"""
    floor: FloatArray
    """(C,) mean squared error that noise alone leaves in each column"""
    reader: Model
    """The one that reads the pivot's angle, and ..."""
    pivots: tuple[FloatArray, ...]
    """... that angle in each run"""
    bound: FloatArray
    """(C,) variance of each column's sensor over these runs: who knows nothing of the leg errs by it"""
    misfits: FloatArray
    """(R,) -2 log likelihood of each run under the nominal model and the noise of the reference"""


@dataclass(frozen=True)
class ErrorTable:
    """Squared free-run errors of several models on runs that chose nothing."""

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
        values = self.values[model] if blocks is None else self.values[model][blocks]
        found = float(np.sqrt(values.mean()))
        return found if np.isfinite(found) else np.inf

    def excess(self, model: int, blocks: NDArray[np.intp] | None = None) -> float:
        """Mean square beyond noise alone."""
        return max(self.error(model, blocks) ** 2 - 1.0, 0.0)

    def draws(self, rng: np.random.Generator) -> NDArray[np.intp]:
        """(DRAWS, B) blocks of resampled runs."""
        count = self.values.shape[1]
        return rng.integers(0, count, (DRAWS, count), dtype=np.intp)

    def lowers(self, model: int, than: int, by: float, draws: NDArray[np.intp], of: int) -> float:
        """Share of resamplings in which `model` has less error than `than` by more than the share `by` of that of the
        model `of`. All are of one resampling: a free run that strays once makes most of the error, and a fall that is
        asked for in its units would not be seen wherever that piece is not drawn."""
        return float(np.mean([self.error(than, d) - self.error(model, d) > by * self.error(of, d) for d in draws]))

    def raises(self, model: int, than: int, by: float, of: int) -> bool:
        """Whether any run's error is more with `model` than with `than` by the share `by` of that of the model `of`
        over all runs: a run that hardly errs may err a little more."""
        each = [np.flatnonzero(self.runs == k) for k in np.unique(self.runs)]
        return any(self.error(model, d) - self.error(than, d) > by * self.error(of) for d in each)


class Measured(NamedTuple):
    """Of one run."""

    squares: FloatArray
    """(readers, M, B, C)"""
    floor: FloatArray
    """(C,)"""
    moments: FloatArray
    """(2, C)"""
    misfits: FloatArray
    """(M,)"""
    pivots: FloatArray
    """(readers, N)"""
    stiction: FloatArray | None


def measure_errors(models: Sequence[Model], reference: Model, seeds: NDArray[np.int64],
                   readers: Sequence[int] | None = None, noise: FloorNoise | None = None) -> ErrorTable:
    """Errors of `models`, the nominal one first, on their confirm runs, one of `seeds` each, in units of what `noise`,
    by default the reference's own, leaves of the `reference`. One of `readers`, by default of all models, reads the
    pivot's angle.

    No error counts for more than that of who takes every sensor's mean: a simulation that strays from the motion, once
    it has, says nothing more. Raises `FitError` where the reference's simulation runs off.
    """
    split = reference.split
    best = next((k for k, m in enumerate(models) if m is reference), len(models))
    every = [*models, *([reference] if best == len(models) else [])]
    could = list(range(len(models)) if readers is None else readers)
    drawn = white_noise(reference) if noise is None else noise

    def measured(k: int) -> Measured:
        run = split.confirm[k]
        fitted = [smooth(model, run) for model in every]
        pivots = np.stack([fitted[r].state.x.q[:, 0] for r in could])
        floor = _floor(fitted[best], seeds[k], drawn)
        return Measured(_squares(fitted[: len(models)], pivots), floor, _moments(fitted[best]),
                        _misfits(fitted, reference)[: len(models)], pivots, split.stiction.get(run))

    parts = parallel_map(measured, len(split.confirm), split.workers)
    for run, part in zip(split.confirm, parts):  # another process found it; later rows are to have the same weights
        if part.stiction is not None:
            split.stiction.setdefault(run, part.stiction)
    lengths = [p.squares.shape[2] for p in parts]
    floor, moments = (np.average(of, axis=0, weights=lengths) for of in ([p.floor for p in parts],
                                                                         [p.moments for p in parts]))
    bound = moments[1] - moments[0] ** 2
    misfits = np.stack([p.misfits for p in parts], axis=-1)
    reader = int(np.argmin(misfits.sum(axis=1)[could]))
    squares = np.concatenate([p.squares[reader] for p in parts], axis=1)
    floor = _least(floor, np.minimum(squares, bound))
    unit = Unit(reference, drawn, floor, models[could[reader]], tuple(p.pivots[reader] for p in parts), bound,
                misfits[0])
    return ErrorTable(_columns_of(reference), _bounded([squares], floor, bound),
                      misfits[0] - misfits, np.repeat(np.arange(len(parts)), lengths), tuple(models), unit)


def extend_errors(table: ErrorTable, more: Sequence[Model]) -> ErrorTable:
    """`table` with rows for `more` models."""
    split = table.unit.reference.split

    def measured(k: int) -> tuple[FloatArray, FloatArray]:
        fitted = [smooth(model, split.confirm[k]) for model in more]
        return (_squares(fitted, table.unit.pivots[k][None])[0],
                table.unit.misfits[k] - _misfits(fitted, table.unit.reference))

    if not more:
        return table
    parts = parallel_map(measured, len(split.confirm), split.workers)
    values = _bounded([p[0] for p in parts], table.unit.floor, table.unit.bound)
    agreement = np.stack([p[1] for p in parts], axis=-1)
    return replace(table, values=np.concatenate([table.values, values]), models=(*table.models, *more),
                   agreement=np.concatenate([table.agreement, agreement]))


def with_floor(table: ErrorTable, noise: FloorNoise, seeds: NDArray[np.int64]) -> ErrorTable:
    """`table` in units of what this `noise` leaves of its reference, with one of `seeds` a confirm run.

    Raises `FitError`."""
    unit = table.unit
    split = unit.reference.split

    def measured(k: int) -> FloatArray:
        return _floor(smooth(unit.reference, split.confirm[k]), seeds[k], noise)

    parts = parallel_map(measured, len(split.confirm), split.workers)
    lengths = np.bincount(table.runs, minlength=len(parts))
    floor = _least(np.average(parts, axis=0, weights=lengths), table.values * unit.floor)
    return replace(table, values=table.values * (unit.floor / floor), unit=replace(unit, noise=noise, floor=floor))


def _least(floor: FloatArray, squares: FloatArray) -> FloatArray:
    """(C,) the floor, at most the least mean of the models' `squares` (M, B, C).

    Noise leaves no more than a model of the same runs errs.
    """
    return np.asarray(np.fmin(floor, np.fmin.reduce(squares.mean(axis=1))))


def _floor(fitted: SmoothedRun, seed: np.int64, noise: FloorNoise) -> FloatArray:
    """(C,) mean squared errors of a replicate of one run with this `noise` alone."""
    found = floor_errors(fitted, np.random.default_rng(seed), HORIZONS_S, noise)
    return np.array([f[c].mean() for f in found for c in sorted(f)])


def choose_rows(table: ErrorTable, rows: Sequence[int]) -> ErrorTable:
    """`table` with these rows alone, in this order."""
    return replace(table, values=table.values[list(rows)], agreement=table.agreement[list(rows)],
                   models=tuple(table.models[k] for k in rows))


def _columns_of(model: Model) -> tuple[tuple[str, float], ...]:
    """Sensors, alphabetically, at each horizon."""
    split = model.split
    problem = split.problem(split.confirm[:1], model.problem.stage.angle_range, model.effects)
    names = sensors_of(problem, np.zeros(problem.total))
    return tuple((c, horizon) for horizon in HORIZONS_S for c in names)


def _squares(fitted: Sequence[SmoothedRun], pivots: FloatArray) -> FloatArray:
    """(P, M, B, C) mean squared errors over blocks of a run that the models are `fitted` to, the pivot's angle being
    each of `pivots` (P, N) in turn."""
    split = fitted[0].model.split
    size = max(10, int(BLOCK_S * split.runs[fitted[0].run][0].rate_hz))
    errors: list[list[FloatArray]] = [[] for _ in fitted]
    for horizon in HORIZONS_S:
        for row, one in zip(errors, fitted):
            found = resimulate(one, pivots[0], True, horizon)
            for column, y in found.measured.items():
                read = pivots if column == PIVOT and split.has_imu and 0 not in split.encoders else y[None]
                squares = _blocks((found.simulated[column] - read) ** 2, size)
                row.append(np.broadcast_to(squares, (len(pivots), squares.shape[1])))
    return np.stack([np.stack(row, axis=-1) for row in errors], axis=1)


def _moments(fitted: SmoothedRun) -> FloatArray:
    """(2, C) mean, and mean square, of what each column's sensor measured."""
    measured = sensors_of(fitted.problem, fitted.state.x.q[:, 0]).values()
    return np.tile([[y.mean() for y in measured], [np.mean(y**2) for y in measured]], len(HORIZONS_S))


def _bounded(squares: Sequence[FloatArray], floor: FloatArray, bound: FloatArray) -> FloatArray:
    """(M, B, C) of all runs, each (M, blocks, C), in units of the floor."""
    return np.asarray(np.minimum(np.concatenate(squares, axis=1), bound) / floor)


def _misfits(fitted: Sequence[SmoothedRun], reference: Model) -> FloatArray:
    """(M,) -2 log likelihood up to a constant, all under the noise of the reference."""
    return np.array([one.problem.motion_equations(one.state.x, one.state.beta, reference.state.noise).objective
                     for one in fitted])


def _blocks(squares: FloatArray, size: int) -> FloatArray:
    """(P, B) means over blocks of about `size` of (P, N)."""
    parts = np.array_split(squares, max(1, squares.shape[1] // size), axis=1)
    return np.stack([part.mean(axis=1) for part in parts], axis=-1)
