"""Angle, rate and acceleration inside sampling intervals, compiled: a search asks for them at every step."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.numerics import at, compile_kernel

STRIP = 64
"""Intervals whose ends are gathered at a time."""


def interval_features(q: FloatArray, v: FloatArray, left: NDArray[np.int64], basis: FloatArray) -> FloatArray:
    """(F, n, G, K) F features of the motion at G points inside the intervals from samples `left` (K,) to the next.

    Each is the sum of (q0, v0, q1, v1) at the interval's ends by weights `basis` (G, F, 4); q, v are (N, n).
    """
    points, count, _ = basis.shape
    out = np.empty((count, q.shape[1], points, left.size))
    _sums()(np.ascontiguousarray(q), np.ascontiguousarray(v), left, basis, out, np.empty((4, STRIP)))
    return out


@cache
def _sums() -> Callable[..., None]:
    def run(q: Any, v: Any, left: Any, basis: Any, out: Any, ends: Any) -> None:
        for j in range(out.shape[1]):
            for start in range(0, left.size, STRIP):
                size = min(STRIP, left.size - start)
                for w in range(size):
                    k = at(left[at(start + w)])
                    ends[0, w], ends[1, w] = q[k, j], v[k, j]
                    ends[2, w], ends[3, w] = q[k + at(1), j], v[k + at(1), j]
                for f in range(out.shape[0]):
                    for g in range(out.shape[2]):
                        a, b, c, d = basis[g, f, 0], basis[g, f, 1], basis[g, f, 2], basis[g, f, 3]
                        for w in range(size):
                            out[f, j, g, at(start + w)] = (a * ends[0, w] + b * ends[1, w] + c * ends[2, w]
                                                           + d * ends[3, w])

    return compile_kernel(run, "f2 f2 i1 f3 f4 f2")
