"""`measure_gain`: free-run errors on the confirm runs before and after an extension, and the gap that it closes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.diagnosis.decision_rule import DRAWS
from estimator.diagnosis.error_table import about_zero, floor_of, sensors_of
from estimator.diagnosis.refit import Model, smooth
from estimator.diagnosis.result import SensorGain, ShortRuns, Trace
from estimator.errors import FitError
from estimator.parallel import parallel_map
from estimator.prediction import (
    BLOCK_S,
    SHORT_S,
    FloorNoise,
    PredictedRun,
    Predictor,
    SmoothedRun,
    predict_run,
    smooth_segments,
    tabulate,
)


@dataclass(frozen=True)
class Gain:
    """Free-run errors on the confirm runs."""

    sensors: dict[str, SensorGain]
    closed: float | None
    """Share of the gap that the extension closes; None where noise alone leaves as much as the nominal model errs."""
    ci95: tuple[float, float] | None
    torque: tuple[tuple[float, ...], tuple[float, ...]]
    traces: tuple[Trace, ...]


def measure_gain(nominal: Model, extended: Model, rng: np.random.Generator, noise: FloorNoise, horizon_s: float = np.inf
                 ) -> Gain:
    """Before, after and floor on the confirm runs, with the share of the gap closed and its block bootstrap.

    The errors are those of `estimator.prediction`, as `legid validate` has them. For the share each squared error is
    capped at the sensor's variance, and the error of a pivot's angle without an encoder is about its mean, as in
    `error_table`.
    """
    split, names = extended.split, sensors_of(extended)
    seeds = rng.integers(2**63, size=len(split.confirm))

    def predicted(k: int) -> tuple[PredictedRun, FloatArray, FloatArray]:
        run = split.confirm[k]
        fitted = as_validated(extended, run)
        found = predict_run([as_validated(nominal, run), fitted], [horizon_s], misfits=False)
        if not np.isfinite(found.simulated[1]).all():
            raise FitError("the free run diverges")
        return (found, fitted.state.x.q[:, 0],
                floor_of(extended, run, smooth(extended, run), seeds[k], [horizon_s], noise)[0])

    blocks: dict[str, list[tuple[float, float, float]]] = {}
    traces, torque = [], []
    simulated = parallel_map(predicted, len(split.confirm), split.workers)
    for found, pivot, floors in simulated:
        rows = [found.channels.index(name) for name in names]
        measured = np.where(np.isnan(found.measured[rows]), pivot, found.measured[rows])
        torque.append(np.mean(found.residual_torque**2, axis=1))
        before, after = (np.where(np.isnan(y), measured.mean(axis=-1, keepdims=True), y)  # diverged: the sensor's mean
                         for y in found.simulated[:, 0, rows])
        traces.append(Trace(found.run, found.time_s, *(dict(zip(names, y)) for y in (measured, before, after))))
        size = max(10, int(BLOCK_S * found.rate_hz))
        nominals, extendeds = (about_zero(extended, y - measured) for y in (before, after))
        for k, y, one, other, floor in zip(names, measured, nominals, extendeds, floors):
            parts = [np.array_split(e, max(1, y.size // size)) for e in (one**2, other**2, floor)]
            blocks.setdefault(k, []).extend((float(a.mean()), float(b.mean()), float(c.mean()))
                                            for a, b, c in zip(*parts))
    spread = {k: float(np.var(np.concatenate([t.measured[k] for t in traces]))) for k in blocks}
    table = {k: np.minimum(v, spread[k]) for k, v in blocks.items()}  # capped at the sensor's variance
    for v in table.values():  # noise leaves no more than a model of the same runs errs
        v[:, 2] *= min(1.0, float(v[:, :2].mean(axis=0).min()) / max(float(v[:, 2].mean()), 1e-300))
    errors = tabulate([found for found, _, _ in simulated], smoother=1)
    sensors = {k: SensorGain(errors.rms(0, k, horizon_s), errors.rms(1, k, horizon_s), float(np.sqrt(v[:, 2].mean())))
               for k, v in table.items()}
    closed = _closed(table, np.arange(len(next(iter(table.values())))))
    count = len(next(iter(table.values())))
    draws = [_closed(table, rng.integers(0, count, count)) for _ in range(DRAWS)]
    shares = np.array([d for d in draws if d is not None])
    known = closed is not None and len(shares) > DRAWS / 2
    low, high = np.quantile(shares, [0.025, 0.975]) if known else (0.0, 0.0)
    rms = np.sqrt(np.mean(np.array(torque), axis=0))
    return Gain(sensors, closed if known else None, (float(low), float(high)) if known else None,
                (tuple(map(float, rms[0])), tuple(map(float, rms[1]))), tuple(traces))


def as_validated(model: Model, run: int) -> SmoothedRun:
    """Motion of the confirm run `run` by the smoother of `legid validate`; `smooth` holds the noise of the fit, so that
    all explanations have the same weights."""
    split, problem = model.split, model.problem
    predictor = Predictor(split.mechanism, split.options.hold, model.state.beta[: model.width], model.named,
                          angle_range=problem.stage.angle_range, gear_ratio=split.gear_ratio)
    return smooth_segments(predictor, split.names[run], split.runs[run], replace(split.options, noise=split.known),
                           split.starts_s[run])


def in_pieces(nominal: Model, extended: Model, noise: FloorNoise) -> ShortRuns | None:
    """The gain in pieces of SHORT_S; None where they diverge."""
    try:
        gain = measure_gain(nominal, extended, np.random.default_rng(0), noise, SHORT_S)
    except FitError:
        return None
    return ShortRuns(SHORT_S, gain.sensors, gain.closed, gain.ci95)


def _closed(table: Mapping[str, FloatArray], which: NDArray[np.intp]) -> float | None:
    """Share of the gap in mean squared error, sensors weighted by their floor, that the extension closes; None where
    there is no gap."""
    before = after = floor = 0.0
    for values in table.values():
        b, a, f = values[which].mean(axis=0)
        scale = values[:, 2].mean()
        before, after, floor = before + b / scale, after + a / scale, floor + f / scale
    gap = before - floor
    return float(np.clip((before - after) / gap, -1.0, 1.5)) if gap > 0 else None
