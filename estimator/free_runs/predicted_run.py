"""`predict_run`: free runs of several models over one run, at several horizons, with what was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daq import Dataset, FloatArray, IndexArray
from estimator.free_runs.smoothed_run import SmoothedRun
from estimator.likelihood import LOST_RAD, LatentProblem, free_run, pieces, read_motion
from estimator.model import simulate
from estimator.signals import Channel, angle_column, encoder_of, imu_channels, imu_columns

HORIZONS_S = (0.1, 0.5, 1.0, 5.0, np.inf)
"""Lengths of the pieces [s]: a controller's step, a swing, a second, several, and whole gap-free segments. Long free
runs of a leg that sticks are chaotic and tell nothing of friction near rest; short ones do not add up what is slow."""
SHORT_S = 1.0
"""The horizon that stands for prediction, where the whole segment stands for simulation."""


@dataclass(frozen=True)
class PredictedRun:
    """One run as measured, as smoothed and as simulated by M models at H horizons; its segments follow each other."""

    run: str
    rate_hz: float
    time_s: FloatArray
    """(N,), increasing across gaps"""
    ends: IndexArray
    """(S,) sample after each segment's last"""
    channels: tuple[str, ...]
    """(C,) angles of all joints, their rates (`q1d`, ...), then each IMU's columns"""
    measured: FloatArray
    """(C, N) as the sensors read; NaN where none did"""
    smoothed: FloatArray
    """(M, C, N) as the sensors would read on each model's smoothed motion"""
    horizons_s: tuple[float, ...]
    simulated: FloatArray
    """(M, H, C, N) as they would read on free runs; NaN from where a whole segment diverges"""
    starts: IndexArray
    """(H, N) first sample of the piece that each sample is in"""
    lost: IndexArray
    """(M, H) pieces that diverged"""
    misfits: FloatArray
    """(M,) -2 log density of the run, see `SmoothedRun.misfit`; NaN where it was not asked for"""
    torque: FloatArray
    """(N, n) as measured [N m]"""
    residual_torque: FloatArray
    """(M, N, n) what each model's equation of motion leaves [N m]"""

    @property
    def longest_s(self) -> float:
        """Longest of its segments [s]."""
        return float(np.diff(self.ends, prepend=0).max() - 1) / self.rate_hz

    def trace(self, channel: str, model: int) -> FloatArray:
        """(N,) the channel as `model` simulates whole segments."""
        found: FloatArray = self.simulated[model, self.horizons_s.index(np.inf), self.channels.index(channel)]
        return found


def predict_run(smoothed: Sequence[SmoothedRun], horizons_s: Sequence[float] = HORIZONS_S,
                data: Dataset | None = None, misfits: bool = False) -> PredictedRun:
    """Free runs of each model from its own motion in `smoothed`, one a model, all of one run.

    `data` is that run where encoders may be compared that no model reads, such as a benchmark's. A horizon that no
    segment exceeds is as the whole. `misfits` are NaN unless they are asked for.
    """
    first = smoothed[0]
    problem = first.problem
    found = [_every(one, horizons_s) for one in smoothed]
    starts = np.stack([_starts(problem, h) for h in horizons_s])
    return PredictedRun(
        first.run, 1.0 / problem.dt, np.concatenate([s.time_s for s in first.signals]), problem.ends,
        channel_names(problem), _measured(first, data),
        np.stack([rows_of(one.problem, one.state.x.v, read_motion(one.problem, one.state)) for one in smoothed]),
        tuple(horizons_s), np.stack([np.stack([x for x, _ in row]) for row in found]), starts,
        np.array([[lost for _, lost in row] for row in found]),
        np.array([one.misfit() if misfits else np.nan for one in smoothed]), problem.torque,
        np.stack([one.drive - one.problem.motor_torque(one.state.x, one.state.beta) for one in smoothed]))


def _every(smoothed_run: SmoothedRun, horizons_s: Sequence[float]) -> list[tuple[FloatArray, int]]:
    """At each horizon, those that cut no segment simulated once."""
    found: dict[int, tuple[FloatArray, int]] = {}
    counts = [len(pieces(smoothed_run.problem, h)) for h in horizons_s]
    for h, count in sorted(zip(horizons_s, counts), reverse=True):
        if count not in found:
            found[count] = _simulated(smoothed_run, h)
    return [found[count] for count in counts]


def channel_names(problem: LatentProblem) -> tuple[str, ...]:
    """(C,) angles, rates, then the columns of each IMU."""
    m = problem.mechanism
    names = [angle_column(m, j) for j in range(m.n)] + [f"q{j + 1}d" for j in range(m.n)]
    return (*names, *(c for k in range(problem.imu_count) for c in imu_columns(k)))


def rows_of(problem: LatentProblem, v: FloatArray, readings: Mapping[Channel, FloatArray]) -> FloatArray:
    """(C, N) in the order of `channel_names`."""
    angles = [readings[encoder_of(j)] for j in range(problem.n)]
    imu = [readings[c] for k in range(problem.imu_count) for c in imu_channels(k)]
    return np.stack([*angles, *v.T, *imu])


def _measured(smoothed_run: SmoothedRun, data: Dataset | None) -> FloatArray:
    problem = smoothed_run.problem
    out = np.full((len(channel_names(problem)), problem.total), np.nan)
    out[: problem.n] = problem.angles.T
    if data is not None:
        rows = np.concatenate([np.searchsorted(data.time_s, s.time_s) for s in smoothed_run.signals])
        for j in range(problem.n):
            column = angle_column(problem.mechanism, j)
            if column in data:
                out[j] = data[column][rows]
    imu = problem.imu_readings()
    for row, channel in enumerate((c for k in range(problem.imu_count) for c in imu_channels(k)), 2 * problem.n):
        out[row] = imu[channel]
    return out


def _starts(problem: LatentProblem, horizon_s: float) -> IndexArray:
    """(N,) first sample of each sample's piece."""
    parts = pieces(problem, horizon_s)
    return np.repeat([p.start for p in parts], [p.stop - p.start for p in parts]).astype(np.intp)


def _simulated(one: SmoothedRun, horizon_s: float) -> tuple[FloatArray, int]:
    """(C, N), and how many pieces diverged."""
    found = free_run(one.problem, one.state, one.drive, horizon_s, bool(np.isfinite(horizon_s)))
    if found is not None:
        return rows_of(one.problem, found.v, found.readings), found.lost
    out = np.full((len(channel_names(one.problem)), one.problem.total), np.nan)
    parts = pieces(one.problem, horizon_s)
    if one.problem.effects or one.problem.closed:
        return out, len(parts)
    lost = 0
    for where in parts:
        q, v = _until_lost(one, where)
        out[: 2 * one.problem.n, where] = np.concatenate([q.T, v.T])
        lost += not np.isfinite(q).all()
    return out, lost


def _until_lost(one: SmoothedRun, where: slice) -> tuple[FloatArray, FloatArray]:
    """(N, n) angles and rates of a plain model's piece, NaN from where it diverges."""
    x, c, m = one.state.x, one.problem.collocation, one.problem.mechanism
    q, v, _ = simulate(m, one.state.beta, x.q[where.start], x.v[where.start], one.drive[where], c.dt, c.hold,
                       (x.q[where], x.v[where]))
    good = np.isfinite(q).all(axis=1) & (np.abs(q - x.q[where]).max(axis=1) < LOST_RAD)
    last = len(q) if good.all() else int(np.argmin(good))
    q[last:], v[last:] = np.nan, np.nan
    return q, v
