"""`measured_use`: a use of a model by its errors on blocks of data that it was not fitted to."""

from __future__ import annotations

import numpy as np

from daq import FloatArray, IndexArray
from estimator.free_runs.table import Ratio, log_ratio, paired_ratio
from estimator.use import ENOUGH, Purpose, Use

FEWEST = 3
"""Runs, or blocks, from whose scatter an interval is made: Student's t of two degrees of freedom is wide."""


def measured_use(use: Purpose, error: FloatArray, size: FloatArray, run: IndexArray, horizon_s: float | None = None
                 ) -> Use:
    """A use by the root of the sum of `error` (B,) over that of `size` (B,), of blocks of the runs `run` (B,).

    An interval that ends above 1 says nothing, and is left out.
    """
    value, ci95 = on_one_more(error, size, run)
    if ci95 is None:
        return Use(use, False, value, horizon_s=horizon_s)
    return Use(use, ci95[1] <= ENOUGH, value, horizon_s=horizon_s, ci95=ci95 if ci95[1] < 1.0 else None)


def on_one_more(error: FloatArray, size: FloatArray, run: IndexArray) -> Ratio:
    """Root of the sum of `error` (B,) over that of `size` (B,), and its 95 % interval on one more run.

    That is sqrt(1 + R) times as wide as that of the mean, which is by the scatter of runs, or by `paired_ratio` over
    blocks where there are fewer runs than FEWEST.
    """
    value, ci95 = paired_ratio(error, size, run, FEWEST)
    if ci95 is None:
        return Ratio(value, None)
    sums = np.array([np.bincount(run, x, int(run.max()) + 1) for x in (size, error)])
    count = sums.shape[1]
    middle, half = log_ratio(sums) if count >= FEWEST else (np.log(value), np.log(ci95[1] / value))
    low, high = (float(np.exp(middle + sign * half * (1 + count) ** 0.5)) for sign in (-1, 1))
    return Ratio(value, (low, high))
