"""`measure_gain`: free-run errors on the test runs before and after an extension, and the gap that it closes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq import FloatArray, IndexArray
from estimator.diagnosis.decision_rule import DRAWS
from estimator.diagnosis.error_table import NOMINAL, ErrorTable, floor_of, judged, sensors_of
from estimator.diagnosis.model import Model, smooth
from estimator.diagnosis.result import HorizonGain, SensorGain, Trace
from estimator.errors import FitError
from estimator.parallel import parallel_map
from estimator.prediction import (
    FittedModel,
    FloorNoise,
    PredictedRun,
    SmoothedRun,
    predict_run,
    smooth_segments,
    tabulate,
)


@dataclass(frozen=True)
class Gain:
    """Free-run errors on the test runs."""

    sensors: dict[str, SensorGain]
    closed: float | None
    """Share of the gap that the extension closes; None where noise alone leaves as much as the nominal model errs."""
    ci95: tuple[float, float] | None
    torque: tuple[tuple[float, ...], tuple[float, ...]]
    traces: tuple[Trace, ...]


def smoothed_tests(told: Sequence[FittedModel], extended: Model) -> list[list[SmoothedRun]]:
    """Motion of each test run under both models that are `told` by the smoother of `legid validate`, then by `smooth`.

    That holds the noise of the extended fit, so that all explanations have the same weights."""
    split = extended.split.as_read()

    def smoothed(k: int) -> list[SmoothedRun]:
        run, options = split.test[k], replace(split.options, noise=split.known)
        return [*(smooth_segments(model, split.names[run], split.runs[run], options, split.starts_s[run])
                  for model in told), smooth(extended, run)]

    return parallel_map(smoothed, len(split.test), split.workers)


def measure_gain(extended: Model, smoothed: Sequence[Sequence[SmoothedRun]], rng: np.random.Generator,
                 noise: FloorNoise) -> Gain:
    """Before, after and floor on the test runs as `smoothed_tests` has them, with the share of the gap closed and its
    block bootstrap.

    The errors are those of `estimator.prediction`, as `legid validate` has them; the share is by those of an
    `ErrorTable`. Raises `FitError` where the extended model's free run diverges.
    """
    split = extended.split
    seeds = rng.integers(2**63, size=len(split.test))

    def predicted(k: int) -> tuple[PredictedRun, FloatArray]:
        *both, fitted = smoothed[k]
        found = predict_run(both, [np.inf])
        if not np.isfinite(found.simulated[1]).all():
            raise FitError("the free run diverges")
        floor = floor_of(extended, split.test[k], fitted, seeds[k], [np.inf], noise, len(seeds))
        return found, floor.mean(axis=-1)

    parts = parallel_map(predicted, len(split.test), split.workers)
    runs = [run for run, _ in parts]
    table, plain = judged(extended, runs, [floor for _, floor in parts], [1], rng), tabulate(runs, smoother=1,
                                                                                            every_horizon=True)
    sensors = {sensor: SensorGain(plain.rms(0, sensor, np.inf), plain.rms(1, sensor, np.inf), float(floor**0.5))
               for (sensor, _), floor in zip(table.columns, table.floor)}
    closed = _closed(table, np.arange(len(table.runs)))
    shares = np.array([share for d in table.draws if (share := _closed(table, d)) is not None])
    known = closed is not None and len(shares) > DRAWS / 2
    low, high = np.quantile(shares, [0.025, 0.975]) if known else (0.0, 0.0)
    torque = np.sqrt(np.mean([np.mean(run.residual_torque**2, axis=1) for run in runs], axis=0))
    return Gain(sensors, closed if known else None, (float(low), float(high)) if known else None,
                (tuple(map(float, torque[0])), tuple(map(float, torque[1]))),
                tuple(_trace(run, sensors_of(extended)) for run in runs))


def gains_by_horizon(table: ErrorTable, row: int) -> tuple[HorizonGain, ...]:
    """Error of the model in `row` over that of the nominal one, at each horizon."""
    found = []
    for horizon_s in dict.fromkeys(horizon_s for _, horizon_s in table.columns):
        own = replace(table, values=table.values[:, :, [one == horizon_s for _, one in table.columns]])
        low, high = np.quantile(own.errors(row, own.draws) / own.errors(NOMINAL, own.draws), [0.025, 0.975])
        found.append(HorizonGain(horizon_s, own.error(row) / own.error(NOMINAL), (float(low), float(high))))
    return tuple(found)


def _trace(run: PredictedRun, names: tuple[str, ...]) -> Trace:
    """One run over time; where a simulation diverges it is drawn at the sensor's mean."""
    rows = [run.channels.index(name) for name in names]
    measured = np.where(np.isnan(run.measured[rows]), run.smoothed[1, rows], run.measured[rows])
    before, after = (np.where(np.isnan(y), measured.mean(axis=-1, keepdims=True), y)
                     for y in run.simulated[:, 0, rows])
    return Trace(run.run, run.time_s, *(dict(zip(names, y)) for y in (measured, before, after)))


def _closed(table: ErrorTable, blocks: IndexArray) -> float | None:
    """Share of the gap in mean squared error, in units of the noise floor, that the extension closes; None where there
    is no gap."""
    before, after = table.error(0, blocks) ** 2, table.error(1, blocks) ** 2
    return float(np.clip((before - after) / (before - 1.0), -1.0, 1.5)) if before > 1.0 else None
