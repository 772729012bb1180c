"""`PredictionTable`: squared errors of free runs by model, block, channel and horizon, and what is read off them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from daq import BoolArray, FloatArray, IndexArray
from estimator.free_runs.predicted_run import PredictedRun
from estimator.numerics import student_quantile

BLOCK_S = 2.0
"""Length of a block [s]: a few periods of the slowest motion; errors further apart count as independent."""
LEAST_ERROR = 1e-8
"""Squared errors below this share of a sensor's variance are alike."""
REST = 0.05
"""Share of a joint's rms rate below which it is at rest."""
LEAST_UNITS = 5
"""Fewest runs, or blocks, from whose scatter an interval is made."""


class Ratio(NamedTuple):
    """The rms error of one model over that of another."""

    value: float
    ci95: tuple[float, float] | None
    """None where there are too few runs and blocks, or an error is not finite"""


@dataclass(frozen=True)
class PredictionTable:
    """Squared errors of free runs: M models, B blocks of R runs, C channels, H horizons. See the package's text."""

    runs: tuple[PredictedRun, ...]
    """(R,) with their time series"""
    run: IndexArray
    """(B,) the run that each block is of, from 0"""
    channels: tuple[str, ...]
    read: BoolArray
    """(C,) whether a sensor reads the channel in some run; the others are compared with the motion of `smoother`"""
    horizons_s: tuple[float, ...]
    """(H,) the last is infinite: whole segments"""
    samples: FloatArray
    """(B, C) samples compared"""
    squares: FloatArray
    """(M, B, C, H) mean squared error over the block; infinite where a whole segment diverges, NaN where nothing was
    compared"""
    kept: FloatArray
    """(M, B, C, H) of a prediction that keeps the rate which each piece begins with, and everything else"""
    residual: FloatArray
    """(M, B, C) of the smoothed motion itself: what is left where nothing is predicted"""
    variance: FloatArray
    """(C,) mean squared error of a constant prediction at the sensor's mean, over all runs"""
    smoother: int
    """The model whose smoothed motion stands in for what no sensor reads"""
    held: IndexArray | None = None
    """Runs to which no model was fitted, by their place; None: all"""

    @property
    def judged(self) -> tuple[str, ...]:
        """Channels in which models are compared: each encoder and each gyro that was read."""
        return tuple(c for c, read in zip(self.channels, self.read) if read and not c.startswith("accel"))

    @property
    def angles(self) -> tuple[str, ...]:
        """The joints' angles, read or not."""
        return self.channels[: self.runs[0].residual_torque.shape[-1]]

    def score(self, horizon_s: float, model: int = 0) -> float:
        """One number to choose set-ups by: mean over the joints of the log of error over that of the last velocity
        kept; infinite where a piece diverges, or where no segment is longer than the horizon."""
        if horizon_s not in self.horizons_s or self.lost[model, self.horizons_s.index(horizon_s)]:
            return np.inf
        ratios = [max(self.rms(model, c, horizon_s), 1e-12) / max(self.rms_kept(c, horizon_s, model), 1e-12)
                  for c in self.angles]
        return float(np.mean(np.log(ratios)))

    @cached_property
    def capped(self) -> FloatArray:
        """(M, B, C, H) `squares`, each at most the sensor's variance: a free run that is lost errs no more than who
        knows nothing of the machine."""
        return np.minimum(self.squares, self.variance[:, None])

    def by_block(self, horizon_s: float) -> FloatArray:
        """(M, B) mean squared error of each block over the `judged` channels, in units of each sensor's variance."""
        which = [self.channels.index(c) for c in self.judged]
        shares = self.capped[:, :, which, self.horizons_s.index(horizon_s)] / np.maximum(self.variance[which], 1e-300)
        return np.asarray(np.maximum(shares, LEAST_ERROR).mean(axis=-1))

    def torques(self, model: int, joints: list[int]) -> tuple[FloatArray, FloatArray]:
        """(B,) squared error of a model's torque, and (B,) square of the measured one, summed over `joints` and the
        samples of each block, in units of each joint's mean square."""
        unit = np.maximum(np.mean(np.concatenate([run.torque[:, joints] for run in self.runs]) ** 2, axis=0), 1e-300)
        sums = [[_sums((x[:, joints] ** 2 / unit).sum(axis=1), _edges(run))
                 for x in (run.residual_torque[model], run.torque)] for run in self.runs]
        errors, sizes = np.concatenate(sums, axis=1)
        return errors, sizes

    def torques_by_speed(self, model: int, joint: int) -> tuple[FloatArray, FloatArray]:
        """(3, B) squared error of a model's torque summed over the samples of each block at which the joint is at rest,
        slow and fast, and (3, B) their number."""
        rates = [np.abs(run.smoothed[self.smoother, run.torque.shape[1] + joint]) for run in self.runs]
        rms = float(np.sqrt(np.mean(np.concatenate(rates) ** 2)))
        sums = []
        for run, rate in zip(self.runs, rates):
            inside = np.digitize(rate, [REST * rms, rms]) == np.arange(3)[:, None]
            sums.append(_sums(np.stack([inside * run.residual_torque[model, :, joint] ** 2, inside]), _edges(run)))
        errors, counts = np.concatenate(sums, axis=2)
        return errors, counts

    @cached_property
    def misfits(self) -> FloatArray:
        """(M, R) -2 log density of each run under each model, up to a constant; see `SmoothedRun.misfit`."""
        return np.stack([r.misfits for r in self.runs], axis=-1)

    @cached_property
    def pieces(self) -> IndexArray:
        """(H,) of all runs."""
        return np.array([sum(np.unique(r.starts[r.horizons_s.index(h)]).size for r in self.runs)
                         for h in self.horizons_s])

    @cached_property
    def lost(self) -> IndexArray:
        """(M, H) pieces that diverged."""
        return np.array([[sum(r.lost[m, r.horizons_s.index(h)] for r in self.runs) for h in self.horizons_s]
                         for m in range(len(self.squares))])

    def rms(self, model: int, channel: str, horizon_s: float, run: int | None = None) -> float:
        """Root mean square error over all samples, of one run or of all; infinite where a whole segment diverges, NaN
        where nothing was compared."""
        return self._root(self.squares[model, :, :, self.horizons_s.index(horizon_s)], channel, run)

    def rms_kept(self, channel: str, horizon_s: float, model: int = 0) -> float:
        """The same of the last velocity kept."""
        return self._root(self.kept[model, :, :, self.horizons_s.index(horizon_s)], channel)

    def rms_residual(self, channel: str) -> float:
        """The same of the first model's smoothed motion itself."""
        return self._root(self.residual[0], channel)

    def _root(self, squares: FloatArray, channel: str, run: int | None = None) -> float:
        c = self.channels.index(channel)
        weights = self.samples[:, c] * (True if run is None else self.run == run)
        if not weights.any():
            return np.nan
        return float(np.sqrt(np.sum(np.where(weights > 0, squares[:, c], 0.0) * weights) / weights.sum()))

    def fit_percent(self, model: int, channel: str, horizon_s: float, run: int) -> float:
        """100 (1 - error / spread) [%], MATLAB's NRMSE fit of one run: 100 is exact, 0 a constant at the run's mean,
        minus infinity where a whole segment diverges."""
        one = self.runs[run]
        spread = float(np.nanstd(one.measured[self.channels.index(channel)]))
        return 100.0 * (1.0 - self.rms(model, channel, horizon_s, run) / spread) if spread else np.nan

    def compared(self, model: int, than: int, channel: str, horizon_s: float) -> Ratio:
        """Rms error of `model` over that of `than`, with its 95 % interval; see `paired_ratio`."""
        c, h = self.channels.index(channel), self.horizons_s.index(horizon_s)
        weights = self.samples[:, c]
        sums = np.where(weights > 0, self.squares[:, :, c, h], 0.0) * weights
        return paired_ratio(sums[model], sums[than], self.run)

    def joined_with(self, other: PredictionTable) -> PredictionTable:
        """Table with the models of `other` after these. Both are of the same runs."""
        runs = tuple(together(a, b) for a, b in zip(self.runs, other.runs, strict=True))
        return replace(self, runs=runs, squares=np.concatenate([self.squares, other.squares]),
                       samples=np.minimum(self.samples, other.samples), read=self.read & other.read,
                       kept=np.concatenate([self.kept, other.kept]),
                       residual=np.concatenate([self.residual, other.residual]))


def together(a: PredictedRun, b: PredictedRun) -> PredictedRun:
    return replace(a, smoothed=np.concatenate([a.smoothed, b.smoothed]),
                   simulated=np.concatenate([a.simulated, b.simulated]), lost=np.concatenate([a.lost, b.lost]),
                   misfits=np.concatenate([a.misfits, b.misfits]),
                   residual_torque=np.concatenate([a.residual_torque, b.residual_torque]))


def paired_ratio(a: FloatArray, b: FloatArray, run: IndexArray, least: int = LEAST_UNITS) -> Ratio:
    """Root of sum a / sum b, summed squared errors (B,) of the same blocks, which belong to the runs `run` (B,).

    The interval is that of the log ratio by the jackknife over runs, or over blocks where there are fewer than
    `least` runs, with Student's t (Efron 1982).
    """
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return Ratio(float(np.sqrt(a.sum() / b.sum())) if np.isfinite(b).all() else np.nan, None)
    if b.sum() <= 0.0:
        return Ratio(np.nan, None)
    value = float(np.sqrt(a.sum() / b.sum()))
    units = [run == k for k in np.unique(run)]
    if len(units) < least:
        units = [np.arange(a.size) == k for k in range(a.size)]
    if len(units) < least or a.sum() <= 0.0:
        return Ratio(value, None)
    left_a, left_b = (np.maximum(x.sum() - np.array([x[u].sum() for u in units]), 1e-300) for x in (a, b))
    logs, count = 0.5 * np.log(left_a / left_b), len(units)
    std = np.sqrt((count - 1) / count * np.sum((logs - logs.mean()) ** 2))
    half = student_quantile(count - 1) * float(std)
    return Ratio(value, (float(value * np.exp(-half)), float(value * np.exp(half))))


def log_ratio(errors: FloatArray) -> tuple[float, float]:
    """Mean log of the second's rms errors over the first's, of errors (2, S), and half of its 95 % interval.

    In logarithms no single second decides. One second alone has no interval.
    """
    ratio = 0.5 * np.log(errors[1] / errors[0])
    if len(ratio) < 2:
        return float(ratio.mean()), np.inf
    half = student_quantile(len(ratio) - 1) * float(ratio.std(ddof=1)) / len(ratio) ** 0.5
    return float(ratio.mean()), half


def tabulate(runs: Sequence[PredictedRun], smoother: int | None = None, *, about_mean: bool = False,
             every_horizon: bool = False, each_piece: bool = False) -> PredictionTable:
    """The table of `runs`. The `smoother` is by default the model under which they are likeliest.

    A block is about `BLOCK_S` long, or with `each_piece` one piece of the first horizon.

    Without `every_horizon` those that no segment exceeds are left out: they are as the whole. `about_mean`: the error
    of an angle that no sensor reads is about its mean over the run. Its zero is no reading: two models read the IMU's
    some milliradians apart, and nothing moves by that.
    """
    first, longest = runs[0], max(r.longest_s for r in runs)
    horizons = tuple(h for h in first.horizons_s if np.isinf(h) or h < longest or every_horizon)
    if smoother is None:
        smoother = int(np.argmin(sum(r.misfits for r in runs)))
    which = [first.horizons_s.index(h) for h in horizons]
    measured = np.concatenate([r.measured for r in runs], axis=1)
    read = np.isfinite(measured).any(axis=1)
    edges = [np.append(np.unique(r.starts[0]), r.time_s.size) if each_piece else _edges(r) for r in runs]
    compared = [np.where(read[:, None], r.measured, r.smoothed[smoother]) for r in runs]
    samples = np.concatenate([_sums(np.isfinite(y).astype(float), e) for y, e in zip(compared, edges)], axis=-1)

    def means(errors: Sequence[FloatArray]) -> FloatArray:
        """(..., B, C) of errors (..., C, N), one a run."""
        found = np.concatenate([_sums(np.where(np.isfinite(y), x**2, 0.0), e)
                                for x, y, e in zip(errors, compared, edges)], axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.moveaxis(found / samples, -1, -2)

    simulated = [np.where(np.isnan(x := r.simulated[:, which]), np.inf, x) for r in runs]
    errors = [x - y for x, y in zip(simulated, compared)]
    if about_mean:
        unread = ~read & (np.arange(read.size) < runs[0].residual_torque.shape[-1])
        for one in errors:
            with np.errstate(invalid="ignore"):  # of what diverges
                one[:, :, unread] -= one[:, :, unread].mean(axis=-1, keepdims=True)
            np.copyto(one, np.inf, where=np.isnan(one))
    squares = means(errors)
    kept = means([_kept(r, which) - y for r, y in zip(runs, compared)])
    residual = means([r.smoothed - y for r, y in zip(runs, compared)])
    every = np.concatenate(compared, axis=1)
    return PredictionTable(
        tuple(runs), np.repeat(np.arange(len(runs)), [len(e) - 1 for e in edges]), first.channels, read, horizons,
        samples.T, np.moveaxis(squares, 1, -1), np.moveaxis(kept, 1, -1), residual, np.nanvar(every, axis=1),
        smoother)


def _edges(run: PredictedRun) -> IndexArray:
    """Samples between which blocks of about `BLOCK_S` lie, each within one segment."""
    size, out = max(10, int(BLOCK_S * run.rate_hz)), [0]
    for begin, end in pairwise([0, *map(int, run.ends)]):
        out += [begin + int(x) for x in np.linspace(0, end - begin, max(1, (end - begin) // size) + 1)[1:]]
    return np.array(out)


def _sums(values: FloatArray, edges: IndexArray) -> FloatArray:
    """(..., B) sums of (..., N) between `edges`."""
    return np.asarray(np.add.reduceat(values, edges[:-1], axis=-1), dtype=np.float64)


def _kept(run: PredictedRun, which: Sequence[int]) -> FloatArray:
    """(M, H, C, N) a prediction that keeps what each piece begins with, and moves its angles at their rates."""
    joints = run.residual_torque.shape[-1]
    starts = run.starts[which]
    out = run.smoothed[:, :, starts].transpose(0, 2, 1, 3).copy()
    passed = (np.arange(starts.shape[1]) - starts) / run.rate_hz
    out[:, :, :joints] += out[:, :, joints : 2 * joints] * passed[None, :, None]
    return out
