"""How much of the simulation's error each cause makes, on runs that chose nothing.

A free run starts from the fitted motion and is driven by the measured torque alone, over pieces of `HORIZONS_S`. Its
squared errors, in units of what noise alone leaves in a rehearsal of the same piece, are comparable over channels and
horizons; their mean over all of them is the error of a model. A generic extension, terms without a name that what is
left over asks for, says how much of the rest could be explained at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.diagnosis.conclusion import BLOCK_S, floor_errors, resimulate
from estimator.diagnosis.context import DiagnosisContext, p_of
from estimator.diagnosis.data_split import RunSplit
from estimator.diagnosis.decision_rule import ALPHA, DRAWS, GENERIC_TERMS
from estimator.diagnosis.model_search import start_size
from estimator.diagnosis.refit import Model, refit, smooth
from estimator.diagnosis.result import BudgetRow
from estimator.diagnosis.score_statistics import Tests
from estimator.effects import AnonymousReading, AnonymousTorque
from estimator.errors import FitError
from estimator.parallel import parallel_map

HORIZONS_S = (0.1, 1.0, np.inf)
"""What a controller looks ahead, a swing, and the whole run: long free runs of a leg that sticks are chaotic, and tell
nothing of friction near rest; short ones do not add up what is slow."""
GENERIC_STEPS = 12


@dataclass(frozen=True)
class ErrorTable:
    """Squared free-run errors of several models on runs that chose nothing."""

    columns: tuple[tuple[str, float], ...]
    """(sensor column, horizon [s])"""
    values: FloatArray
    """(M, B, C) mean over a block, in units of what noise alone leaves in that column"""
    agreement: FloatArray
    """(M, R) fall of -2 log likelihood of each run from the first model to this one, both under one noise"""
    reference: Model
    """The model whose noise alone is the unit, and whose pivot's motion is taken for measured."""
    seeds: NDArray[np.int64]
    """(R,) of the rehearsals that noise alone is read off."""

    def error(self, model: int, blocks: NDArray[np.intp] | None = None) -> float:
        """Root mean square of a model's error over all columns; 1 is noise alone."""
        values = self.values[model] if blocks is None else self.values[model][blocks]
        return float(np.sqrt(values.mean()))

    def excess(self, model: int, blocks: NDArray[np.intp] | None = None) -> float:
        """Mean square beyond noise alone."""
        return max(self.error(model, blocks) ** 2 - 1.0, 0.0)

    def draws(self, rng: np.random.Generator) -> NDArray[np.intp]:
        """(DRAWS, B) blocks of resampled runs."""
        count = self.values.shape[1]
        return rng.integers(0, count, (DRAWS, count), dtype=np.intp)

    def lowers(self, model: int, than: int, by: float, draws: NDArray[np.intp]) -> float:
        """Share of resamplings in which `model` has less error than `than` by more than the share `by`."""
        return float(np.mean([self.error(model, d) < (1.0 - by) * self.error(than, d) for d in draws]))


def measure_errors(split: RunSplit, models: Sequence[Model], reference: Model, seeds: NDArray[np.int64]) -> ErrorTable:
    """Errors of `models` on the confirm runs, one of `seeds` each, in units of the noise of `reference`.

    Where a simulation runs off, every sensor's mean stands in for it. Raises `FitError` where the reference's does.
    """
    best = next((k for k, m in enumerate(models) if m is reference), len(models))
    every = [*models, *([reference] if best == len(models) else [])]

    def measured(k: int) -> tuple[list[FloatArray], FloatArray, FloatArray, tuple[tuple[str, float], ...]]:
        run = split.confirm[k]
        fitted = [smooth(split, model, run) for model in every]
        q1 = fitted[best][1].x.q[:, 0]
        size = max(10, int(BLOCK_S * split.runs[run][0].rate_hz))
        errors: list[list[FloatArray]] = [[] for _ in models]
        floors, columns = [], []
        least = floor_errors(split, reference, fitted[best], run, np.random.default_rng(seeds[k]), HORIZONS_S)
        for horizon, floor in zip(HORIZONS_S, least):
            for m, one in enumerate(fitted[: len(models)]):
                found = resimulate(split, one, run, q1, True, horizon)
                errors[m] += [_blocks((found.simulated[c] - y) ** 2, size) for c, y in found.measured.items()]
            floors += [_blocks(floor[c], size) for c in found.measured]
            columns += [(c, horizon) for c in found.measured]
        noise = reference.state.noise
        misfits = np.array([problem.linearise(state.x, state.beta, noise).objective for problem, state in fitted])
        misfits = misfits[: len(models)]
        return [np.stack(e, axis=-1) for e in errors], np.stack(floors, axis=-1), misfits[0] - misfits, tuple(columns)

    parts = parallel_map(measured, len(split.confirm), split.workers)
    floor = np.concatenate([p[1] for p in parts]).mean(axis=0)
    values = np.stack([np.concatenate([p[0][m] for p in parts]) for m in range(len(models))]) / floor
    return ErrorTable(parts[0][3], values, np.stack([p[2] for p in parts], axis=-1), reference, seeds)


def extend_errors(table: ErrorTable, split: RunSplit, nominal: Model, more: Sequence[Model]) -> ErrorTable:
    """`table` with rows for `more` models."""
    if not more:
        return table
    own = measure_errors(split, [nominal, *more], table.reference, table.seeds)
    return replace(table, values=np.concatenate([table.values, own.values[1:]]),
                   agreement=np.concatenate([table.agreement, own.agreement[1:]]))


def budget(table: ErrorTable, row: int, without: Sequence[int], model: Model | None,
           draws: NDArray[np.intp]) -> tuple[BudgetRow, ...]:
    """Shares of the mean squared error beyond noise alone: of each effect of `model`, whose errors stand in `row`, of
    what is left, and what noise alone would be. What several effects take away together is shared out by what is
    missing `without` each. Empty where there is nothing beyond noise."""
    def shares(blocks: NDArray[np.intp] | None) -> FloatArray:
        excess = table.excess(0, blocks)
        if excess <= 0.0:
            return np.full(3 + len(without or ([row] if row else [])), np.nan)
        closed = (table.error(0, blocks) ** 2 - table.error(row, blocks) ** 2) / excess
        each = np.array([max(table.error(k, blocks) ** 2 - table.error(row, blocks) ** 2, 1e-12) for k in without])
        causes = closed * each / each.sum() if len(each) else np.array([closed] if row else [])
        return np.array([1.0, *causes, 1.0 - closed, 1.0 / excess])

    point = shares(None)
    if np.isnan(point).any():
        return ()
    spread = np.array([shares(d) for d in draws])
    low, high = np.nanquantile(spread, [0.025, 0.975], axis=0)
    named = model.named if model is not None and row else ()
    parts = [("nominal", None), *(("cause", e) for e in named), ("remainder", None), ("noise", None)]
    return tuple(BudgetRow(what, float(value), (float(a), float(b)), None if e is None else e.name,
                           None if e is None or e.joint is None else e.joint + 1)
                 for (what, e), value, a, b in zip(parts, point, low, high))


def _blocks(squares: FloatArray, size: int) -> FloatArray:
    return np.array([part.mean() for part in np.array_split(squares, max(1, len(squares) // size))])


def generic_extension(context: DiagnosisContext, model: Model, left: Tests) -> Model | None:
    """`model` with the terms without a name that what it leaves over asks for most, fitted together; None where none
    is detected, or where they cannot be fitted."""
    chosen: list[int] = []
    for _ in range(GENERIC_TERMS):
        known = left.gain(_columns(context, chosen)) if chosen else 0.0
        gains = {i: left.gain(_columns(context, [*chosen, i])) - known
                 for i in range(context.named, context.trials) if i not in chosen}
        best = max(gains, key=lambda i: gains[i])
        if gains[best] < context.material(context.split.discover) or (not chosen and p_of(context, left, best) > ALPHA):
            break
        chosen.append(best)
    if not chosen:
        return None
    start = list(zip(model.effects, model.sizes()))
    start += [(context.candidates[i].effect, start_size(context, left, i)) for i in chosen]
    for count in range(len(start), len(model.effects), -1):  # fewer where all together do not settle
        try:
            return refit(context.split, model, start[:count], GENERIC_STEPS)
        except (FitError, np.linalg.LinAlgError):
            continue
    return None


def generic_terms(model: Model) -> list[AnonymousTorque | AnonymousReading]:
    """Terms without a name in `model`, the one that was asked for most first."""
    return [e for e in model.effects if isinstance(e, AnonymousTorque | AnonymousReading)]


def _columns(context: DiagnosisContext, which: Sequence[int]) -> NDArray[np.intp]:
    return np.concatenate([context.columns[i] for i in which])
