"""`Validation`: one segment of a prediction table, as measured and as simulated (Table V of the paper)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import numpy as np

from daq import FloatArray
from estimator.free_runs import PredictionTable


@dataclass(frozen=True)
class Validation:
    """One gap-free segment of one run: measured against simulated from its first state and torque alone."""

    run: str
    time_s: FloatArray
    """(N,)"""
    q: FloatArray
    """(N, n) simulated [rad]"""
    qd: FloatArray
    reference_q: FloatArray
    """(N, n) measured: encoders where the run has them, else smoothed from the IMU [rad]"""
    reference_qd: FloatArray
    sums: Mapping[str, float]
    """Summed squared errors: q1_rad, q2_rad [rad^2], q1d, q2d [rad^2/s^2] and so on by joint."""
    rmse: Mapping[str, float]
    """Their roots over the samples compared; where the free run diverges, over those before."""
    horizon_s: float
    """How long the free run stayed within bounds."""
    diverged: bool


V = TypeVar("V", bound=Validation)


def validations_of(table: PredictionTable) -> list[Validation]:
    """The whole free runs of the first model, one a gap-free segment."""
    return segments_as(Validation, table)


def segments_as(kind: type[V], table: PredictionTable) -> list[V]:
    """The same as a type that is derived from `Validation`."""
    out = []
    for run in table.runs:
        n = run.residual_torque.shape[-1]
        simulated = run.simulated[0, run.horizons_s.index(np.inf), : 2 * n]
        smoothed = run.smoothed[table.smoother, : 2 * n]
        reference = np.where(np.isfinite(run.measured[: 2 * n]), run.measured[: 2 * n], smoothed)
        compared = np.where(table.read[: 2 * n, None], run.measured[: 2 * n], smoothed)
        for begin, end in pairwise([0, *map(int, run.ends)]):
            where = slice(begin, end)
            good = np.isfinite(simulated[:, where]).all(axis=0)
            last = int(np.argmin(good)) if not good.all() else end - begin
            errors = simulated[:, begin : begin + last] - compared[:, begin : begin + last]
            sums, rmse = {}, {}
            for name, error in zip((table.channels[k] for k in _order(n)), errors[_order(n)]):
                known = error[np.isfinite(error)]
                sums[name] = float(np.sum(known**2)) if last == end - begin else np.inf
                rmse[name] = float(np.sqrt(np.mean(known**2))) if known.size else np.inf
            out.append(kind(run.run, run.time_s[where], simulated[:n, where].T, simulated[n:, where].T,
                            reference[:n, where].T, reference[n:, where].T, sums, rmse, last / run.rate_hz,
                            last < end - begin))
    return out


def _order(n: int) -> list[int]:
    """Angle and rate of each joint, joint by joint, among (2 n,) angles and then rates."""
    return [k for j in range(n) for k in (j, n + j)]
