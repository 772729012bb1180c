r"""Separate noise levels of runs, where runs differ significantly.

Each run is cut into pieces of one length. Log variances of a channel's residual are compared between and within runs
by analysis of variance (Bartlett and Kendall, J. R. Stat. Soc. Suppl. 8, 1946). Runs get separate levels if the
difference is significant and equal weights would raise the variance of the estimates by more than LEAST_RATIO. A run's
level is then shrunk to the common one by its uncertainty (DerSimonian and Laird, Control. Clin. Trials 7, 1986).

If the latents take all but a share f of a channel's residual, the information about its log variance is N f^2 / 2. So
a piece's variance counts 1 / f^2 times.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from daq import FloatArray, IndexArray
from estimator.likelihood import LatentProblem, Noise, NoiseScale, unit_scale
from estimator.options import FitOptions
from estimator.result import RunNoise
from estimator.signals import SignalSet, by_run

CHANCE = 0.01
"""Probability that runs alike differ as much, below which they count as different."""
LEAST_RATIO = 1.05
"""Variance by equal weights over that by the runs' own, below which equal weights stay."""
PIECES = 8
"""Pieces into which a run of mean length is cut."""
LEAST_PIECE = 50
"""Fewest samples of a piece."""
LEAST_LEFT = 0.02
"""Share of a channel's samples that the latents leave at least."""
STEP = 2.0
"""Most by which a level changes at once."""


class Column(NamedTuple):
    """One channel of a fit whose noise is estimated."""

    name: str
    """As levels by joint and axis are called."""
    square: FloatArray
    """(N,) squared residual, times the weight"""
    weight: FloatArray
    """(N,) the share of it that is noise"""
    taken: FloatArray
    """(R,) degrees of freedom that the latents took of each run"""
    kind: str
    """Of `NoiseScale`, and the channel in it: a joint, an IMU, or an IMU and its axis."""
    at: int | tuple[int, int]
    level: float
    floor: float


class RunLevels(NamedTuple):
    """Levels of R runs."""

    ratio: FloatArray
    """(R,) over the root mean square of all"""
    differ: bool
    """Whether the runs differ significantly and by a material amount."""


def columns(problem: LatentProblem, noise: Noise, residuals: Mapping[str, FloatArray], taken: Mapping[str, FloatArray],
            options: FitOptions, floors: Noise) -> Iterator[Column]:
    """Every driven joint's torque, encoder, gyro and axis of the accelerometer whose level is not given."""
    whole, weight = np.ones(problem.total), problem.torque_weight(noise)
    for j in problem.mechanism.actuated:
        if options.torque_noise(j, True) is None:
            yield Column(f"torque{j + 1}_nm", residuals["torque"][:, j] ** 2 * weight[:, j] ** 2, weight[:, j],
                         taken["torque"][:, j], "torque", j, float(noise.torque[j]), float(floors.torque[j]))
    for j in map(int, np.flatnonzero(problem.has_encoder)):
        if options.encoder_noise(j) is None:
            r = residuals["encoder"][:, j] / (1.0 if problem.spread is None else problem.spread[:, j])
            yield Column(f"encoder{j + 1}_rad", r**2, whole, taken["encoder"][:, j], "encoder", j,
                         float(noise.encoder[j]), float(floors.encoder[j]))
    for k in range(problem.imu_count):
        gyro, *axes = imu_names(problem, k)
        if options.gyro_noise(k) is None:
            yield Column(gyro, residuals["gyro"][k] ** 2, whole, taken["gyro"][:, k], "gyro", k, float(noise.gyro[k]),
                         float(floors.gyro[k]))
        for i, axis in enumerate(axes):
            if options.accel_noise(i, k) is None:
                yield Column(axis, residuals["accel"][k, :, i] ** 2, whole, taken["accel"][:, k, i, i], "accel", (k, i),
                             float(noise.accel[k, i]), float(floors.accel[k, i]))


def imu_names(problem: LatentProblem, imu: int) -> tuple[str, str, str]:
    """Names of the levels of an IMU's gyro and accelerometer axes: with its number where there are several."""
    own = imu + 1 if problem.imu_count > 1 else ""
    return f"gyro{own}_radps", f"accel{own}_x_mps2", f"accel{own}_y_mps2"


def renewed(problem: LatentProblem, noise: Noise, old: NoiseScale, residuals: Mapping[str, FloatArray],
            taken: Mapping[str, FloatArray], options: FitOptions, floors: Noise) -> NoiseScale | None:
    """The runs' levels over those of all, which were `old`; None where runs are alike.

    `residuals` are after a step, not weighted, `taken` is of `effective_samples`. A channel that had levels of its runs
    before keeps them, whatever the test says now.
    """
    asked, scale = set(old.channels), unit_scale(problem.total, problem.n, problem.imu_count)
    lengths = np.diff(np.append(problem.run_starts, problem.total))
    for column in columns(problem, noise, residuals, taken, options, floors):
        found = run_levels(column, problem.run_starts, lengths)
        if not found.differ and column.name not in asked:
            continue
        asked.add(column.name)
        before = _of(old, column)[problem.run_starts]
        ratio = np.maximum(before * np.clip(found.ratio / before, 1.0 / STEP, STEP), column.floor / column.level)
        _of(scale, column)[:] = np.repeat(ratio, lengths)
    return replace(scale, channels=frozenset(asked)) if asked else None


def run_levels(column: Column, starts: IndexArray, lengths: IndexArray) -> RunLevels:
    """Noise levels of the runs, which begin at samples `starts` (R,) and have so many, `lengths` (R,)."""
    size = max(LEAST_PIECE, int(np.mean(lengths)) // PIECES)
    counts = np.maximum(lengths // size, 1)
    begin = np.concatenate([s + (np.arange(c) * n) // c for s, n, c in zip(starts, lengths, counts, strict=True)])
    run = np.repeat(np.arange(len(starts)), counts)
    weight = np.maximum(np.add.reduceat(column.weight, starts), 1e-9)
    left = np.clip(1.0 - column.taken / weight, LEAST_LEFT, 1.0)
    known = np.maximum(np.add.reduceat(column.weight, begin) * left[run], 1e-9)
    log = np.log(np.maximum(np.add.reduceat(column.square, begin), 1e-300) / known)
    mean = np.bincount(run, log) / counts
    freedom = len(log) - len(starts)
    within = 2.0 * np.mean(left[run] / known)
    if freedom:
        within = max(within, np.sum((log - mean[run]) ** 2) / freedom)
    variance = within / (counts * left**2)
    w = 1.0 / variance
    centre = np.average(mean, weights=w)
    q, others = np.sum(w * (mean - centre) ** 2), len(starts) - 1
    scatter = max(0.0, (q - others) / float(np.sum(w) - np.sum(w**2) / np.sum(w)))
    centre = np.average(mean, weights=1.0 / (scatter + variance))
    ratio = np.exp(0.5 * (mean - centre) * scatter / (scatter + variance))
    ratio /= np.sqrt(np.average(ratio**2, weights=lengths))
    worth = float(np.mean(ratio**2) * np.mean(ratio**-2))
    differ = freedom > 0 and worth > LEAST_RATIO and _above(q / others, others, freedom) < CHANCE
    return RunLevels(ratio, differ)


def run_noise(problem: LatentProblem, signals: Sequence[SignalSet], noise: Noise) -> RunNoise | None:
    """The runs' own levels, of the channels that have them."""
    if noise.scale is None:
        return None
    of_run = noise.scale.at(problem.run_starts)
    found = {f"torque{j + 1}_nm": noise.torque[j] * of_run.torque[:, j] for j in range(problem.n)}
    found |= {f"encoder{j + 1}_rad": noise.encoder[j] * of_run.encoder[:, j] for j in range(problem.n)}
    for k in range(problem.imu_count):
        levels = noise.gyro[k] * of_run.gyro[k], *(noise.accel[k] * of_run.accel[k]).T
        found |= dict(zip(imu_names(problem, k), levels))
    return RunNoise(tuple(run for run, _, _ in by_run(signals)),
                    {name: levels for name, levels in found.items() if name in of_run.channels})


def _of(scale: NoiseScale, column: Column) -> FloatArray:
    """(N,) a view."""
    values: FloatArray = getattr(scale, column.kind)
    if isinstance(column.at, tuple):
        imu, axis = column.at
        return values[imu, :, axis]
    return values[column.at] if column.kind == "gyro" else values[:, column.at]


def _above(ratio: float, freedom: int, other: int) -> float:
    """Probability of Fisher's F above `ratio` (Paulson, Ann. Math. Stat. 13, 1942)."""
    a, b, root = 2.0 / (9.0 * freedom), 2.0 / (9.0 * other), math.cbrt(ratio)
    return 0.5 * math.erfc(((1.0 - b) * root - (1.0 - a)) / math.sqrt(2.0 * (b * root**2 + a)))
