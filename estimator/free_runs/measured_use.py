"""`measured_use`: a use of a model by its errors on blocks of data that it was not fitted to."""

from __future__ import annotations

import numpy as np

from daq import FloatArray, IndexArray
from estimator.free_runs.table import Ratio, log_ratio, paired_ratio
from estimator.use import ENOUGH, Purpose, Use

FEWEST = 3
"""Runs, or blocks, from whose scatter an interval is made: Student's t of two degrees of freedom is wide."""


def measured_use(use: Purpose, error: FloatArray, size: FloatArray, run: IndexArray, horizon_s: float | None = None,
                 held: IndexArray | None = None) -> Use:
    """A use by the root of the sum of `error` (B,) over that of `size` (B,), as `on_one_more`.

    An interval that ends above 1 says nothing, and is left out.
    """
    value, ci95 = on_one_more(error, size, run, held)
    told = ci95 if ci95 and ci95[1] < 1.0 else None
    return Use(use, bool(told and told[1] <= ENOUGH), value, horizon_s=horizon_s, ci95=told)


def on_one_more(error: FloatArray, size: FloatArray, run: IndexArray, held: IndexArray | None = None) -> Ratio:
    """Root of the sum of `error` (B,) over that of `size` (B,), of blocks of the runs `run` (B,), and its 95 % interval
    on one more run.

    The root is that of the runs `held`, by default of all. In the interval they count as so many runs with the scatter
    of all runs, which too few test runs do not show; or with that of blocks, by `paired_ratio`, where there are fewer
    runs than FEWEST in all.
    """
    names, of_run = np.unique(run, return_inverse=True)
    tested = np.isin(names, names if held is None else held)
    known, count = tested[of_run], tested.sum()
    ratio = paired_ratio(error[known], size[known], run[known], FEWEST)
    if ratio.ci95 is None:
        return ratio
    middle, half = np.log(ratio.value), np.log(ratio.ci95[1] / ratio.value) * count**0.5
    if len(names) >= FEWEST:
        sums = np.array([np.bincount(of_run, x) for x in (size, error)])
        middle, half = log_ratio(sums[:, tested])[0], log_ratio(sums)[1] * len(names) ** 0.5
    low, high = (float(np.exp(middle + sign * half * (1.0 + 1.0 / count) ** 0.5)) for sign in (-1, 1))
    return ratio._replace(ci95=(low, high))
