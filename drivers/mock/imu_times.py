"""When each recorded IMU sample was latched, from the drains that found it: what a replay needs to be punctual."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

Int64s = NDArray[np.int64]


def latch_times(before_ns: Int64s, after_ns: Int64s, gap_before: NDArray[np.bool_],
                nominal_period_ns: float) -> Int64s:
    """(n,) latch time of each sample [ns], even within each stretch between gaps.

    `before_ns`, `after_ns`, `gap_before` are per sample, as `ImuBatch` defines them (all samples of a drain share
    their times). The chip's period and phase are those that respect every drain's two bounds with the widest margin.
    """
    n = len(before_ns)
    out = np.empty(n, np.int64)
    starts = np.flatnonzero(gap_before | (np.arange(n) == 0))
    for start, stop in zip(starts, [*starts[1:], n]):
        part = slice(start, stop)
        out[part] = _stretch(before_ns[part], after_ns[part], nominal_period_ns)
    return out


def _stretch(before_ns: Int64s, after_ns: Int64s, nominal_period_ns: float) -> Int64s:
    """Largest m with  phase + period*K + m <= after  and  phase + period*(K+1) - m >= before,  K last of a drain."""
    n = len(before_ns)
    last = np.append(np.flatnonzero(np.diff(before_ns)), n - 1)
    origin = int(before_ns[0])
    before, after = (before_ns[last] - origin) / nominal_period_ns, (after_ns[last] - origin) / nominal_period_ns
    one, k = np.ones(len(last)), last.astype(float)
    upper = np.column_stack([one, k, one])
    lower = np.column_stack([-one, -(k + 1), one])
    solution = linprog([0, 0, -1], A_ub=np.vstack([upper, lower]), b_ub=np.concatenate([after, -before]),
                       bounds=[(None, None), (0.9, 1.1), (None, None)])
    if solution.x is None:
        raise ValueError(f"recorded IMU drain times fit no sample clock: {solution.message}")
    phase, period, _ = solution.x
    return origin + np.rint((phase + period * np.arange(n)) * nominal_period_ns).astype(np.int64)
