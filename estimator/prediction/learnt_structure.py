"""`find_structure`: what a model leaves in its equations of motion as a function of the state, and what that is worth.

1. Smooth all runs under the model; learn the torque of each joint from the residual (`torque_regression`).
2. Smooth the runs again with the joint that the state explains best; learn all joints again. A model without the
   torque puts part of it down to noise, so the first residual is too small.
3. Repeat both without some runs, and simulate these with the model and with the torques learnt: each run is left out
   once. The error of free runs, paired over the runs, says what is gained.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimator.effects import Points, StateTorque, Table
from estimator.errors import FitError
from estimator.free_runs import (
    SHORT_S,
    FittedModel,
    PredictedRun,
    PredictionTable,
    Ratio,
    SmoothedRun,
    paired_ratio,
    predict_run,
    tabulate,
)
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.parallel import parallel_map
from estimator.prediction.smoothing import smooth_segments
from estimator.prediction.torque_regression import LearntTorque, Samples, learn_torque, samples_of
from estimator.signals import SignalSet

FOLDS = 4
"""Groups of runs that are left out in turn."""
HORIZONS_S = (0.1, SHORT_S, np.inf)
"""Of the free runs that count [s]: what a controller looks ahead, a swing, the whole run."""


@dataclass(frozen=True)
class RunSignals:
    """The gap-free segments of one run."""

    name: str
    signals: tuple[SignalSet, ...]
    session_s: float = 0.0
    """Its begin in the session"""


@dataclass(frozen=True)
class Structure:
    """Torques that repeat in all runs as functions of the state."""

    torques: tuple[LearntTorque, ...]
    """One a joint, learnt from all runs"""
    samples: Samples
    """The residuals that they were learnt from"""
    mechanism: Mechanism
    table: PredictionTable
    """Free-run errors of the model, then of the model with torques learnt without the run"""
    remaining: Ratio
    """Rms error with the torques over that without, over all sensors and horizons"""

    @property
    def removed(self) -> float:
        """Share of the free-run rms error on left-out runs that the torques remove."""
        return 1.0 - self.remaining.value

    @property
    def removed_ci95(self) -> tuple[float, float] | None:
        """Its 95 % interval over the runs; None with too few."""
        found = self.remaining.ci95
        return None if found is None else (1.0 - found[1], 1.0 - found[0])

    def holds(self, material: float) -> bool:
        """Whether it removes a `material` share of the error, surely some, and at no horizon surely adds to it."""
        every = [paired_error(self.table, slice(h, h + 1)).ci95 for h in range(len(self.table.horizons_s))]
        return (self.removed_ci95 is not None and self.removed_ci95[0] > 0.0 and self.removed >= material
                and not any(ci95 is not None and ci95[0] > 1.0 for ci95 in every))

    @property
    def laws(self) -> tuple[StateTorque, ...]:
        """The effects with which a model has it."""
        return tuple(one.law for one in self.torques)


def find_structure(model: FittedModel, runs: Sequence[RunSignals], options: FitOptions, workers: int = 1
                   ) -> Structure | None:
    """The structure of the residual torques of `model` on these runs; None where the state explains nothing.

    Parameters and effects of the model stay as they are. Raises `FitError` for fewer than two runs, for a walker, and
    where the runs cannot be smoothed.
    """
    if len(runs) < 2:
        raise FitError("one run does not show what repeats between runs")
    if model.mechanism.exchanged:
        raise FitError("the joints of a walker change places with its legs")
    smoothed = parallel_map(lambda k: _smoothed(model, runs[k], options), len(runs), workers)
    torques, samples = _learn(model, runs, smoothed, options)
    if not torques:
        return None
    count = min(FOLDS, len(runs))
    folds = [range(first, len(runs), count) for first in range(count)]

    def left_out(fold: int) -> list[PredictedRun]:
        others = [k for k in range(len(runs)) if k not in folds[fold]]
        found, _ = _learn(model, [runs[k] for k in others], [smoothed[k] for k in others], options)
        laws = [one.law for one in found]
        return [predict_run([smoothed[k], _smoothed(with_torques(model, laws), runs[k], options, smoothed[k])],
                            HORIZONS_S) for k in folds[fold]]

    predicted = [one for fold in parallel_map(left_out, len(folds), workers) for one in fold]
    table = tabulate(predicted, smoother=0)
    return Structure(tuple(torques), samples, model.mechanism, table, paired_error(table))


def with_torques(model: FittedModel, laws: Sequence[StateTorque]) -> FittedModel:
    """`model` with these torques added."""
    return replace(model, effects=(*model.effects, *laws))


def _smoothed(model: FittedModel, run: RunSignals, options: FitOptions, begin: SmoothedRun | None = None
              ) -> SmoothedRun:
    """The run's motion under `model`, sought from that under a similar one in `begin`."""
    return smooth_segments(model, run.name, run.signals, options, run.session_s, None if begin is None else begin.state)


def _learn(model: FittedModel, runs: Sequence[RunSignals], smoothed: Sequence[SmoothedRun], options: FitOptions
           ) -> tuple[list[LearntTorque], Samples]:
    """Torques of the joints, and the residuals that they were learnt from."""
    samples = samples_of(smoothed)
    first = _torques(samples, model)
    if not first:
        return [], samples
    best = max(first, key=lambda one: one.explained_nm / one.noise_nm).law
    again = [_smoothed(with_torques(model, [best]), run, options, one) for run, one in zip(runs, smoothed, strict=True)]
    samples = samples_of(again).plus(best)
    return _torques(samples, model), samples


def _torques(samples: Samples, model: FittedModel) -> list[LearntTorque]:
    found = (learn_torque(samples, j, model.mechanism) for j in range(model.mechanism.n))
    return [one for one in found if one is not None]


def paired_error(table: PredictionTable, horizons: slice = slice(None)) -> Ratio:
    """Rms error of the second model over that of the first, over all judged channels and `horizons`, paired over runs.

    Each channel and horizon counts in units of the first model's error; each squared error is capped at the sensor's
    variance.
    """
    which = [table.channels.index(c) for c in table.judged]
    sums = np.where(table.samples[:, :, None] > 0, table.capped, 0.0) * table.samples[:, :, None]
    sums = sums[:, :, which, horizons]
    units = np.maximum(sums[0].sum(axis=0), 1e-300)
    before, after = (sums / units).sum(axis=(2, 3))
    return paired_ratio(after, before, table.run)


def words_of(table: Table, joint: int) -> str:
    """Inputs of a table of this joint (0-based) in words, such as `angle and direction`."""
    names = [v.kind if v.joint == joint or v.kind == "motor torque" else f"{v.kind} of joint {v.joint + 1}"
             for v in table.variables]
    return " and ".join([*names, *(["direction"] if table.directed else [])])


def outside_range(laws: Sequence[StateTorque], at: Points) -> dict[str, float]:
    """Variable in words to the share of the points outside the range it was learnt in; only those above zero."""
    found: dict[str, float] = {}
    for law in laws:
        for table in law.tables:
            for variable, share in zip(table.variables, table.outside(at)):
                words = f"{variable.kind} of joint {variable.joint + 1}"
                found[words] = max(found.get(words, 0.0), float(share))
    return {words: share for words, share in found.items() if share > 0.0}


def where_of(structure: Structure) -> dict[tuple[int, str], float]:
    """(joint from 1, inputs in words) to the rms torque of that table over the samples [N m], the largest first."""
    found: dict[tuple[int, str], float] = {}
    for law in structure.laws:
        joint = law.joint or 0
        for table in law.tables:
            found[joint + 1, words_of(table, joint)] = float(np.std(table.torque(structure.samples.at, joint)))
    return dict(sorted(found.items(), key=lambda item: -item[1]))
