"""Block lower bidiagonal systems, one step after the other, compiled: what an implicit integrator solves."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from daq import FloatArray
from estimator.numerics.jit import Kernel, at

STRIP = 32
"""Blocks that are put in one place at a time."""


def solve_bidiagonal(blocks: FloatArray, right: FloatArray) -> FloatArray:
    """x (K, b) of L[k] x[k-1] + A[k] x[k] = right[k], x[-1] = 0; blocks (b, 2, b, K) hold L and A, right is (b, K).

    Rows are exchanged within a block. Raises numpy.linalg.LinAlgError where a block is singular or not finite.
    """
    b, count = right.shape
    out = np.empty((count, b))
    _substitute(b)(np.ascontiguousarray(blocks), np.ascontiguousarray(right), out, np.zeros((STRIP, b, 2 * b + 1)))
    if not np.isfinite(out).all():
        raise np.linalg.LinAlgError("a block is singular")
    return out


@cache
def _substitute(b: int) -> Kernel:
    """The kernel for blocks of size b; work (STRIP, b, 2 b + 1) is zeros."""

    def run(blocks: Any, right: Any, out: Any, work: Any) -> None:
        count, last = out.shape[0], 2 * b
        for start in range(0, count, STRIP):
            size = min(STRIP, count - start)
            for i in range(b):
                for j in range(b):
                    for w in range(size):
                        work[w, i, j] = blocks[i, 0, j, at(start + w)]
                        work[w, i, b + j] = blocks[i, 1, j, at(start + w)]
                for w in range(size):
                    work[w, i, last] = right[i, at(start + w)]
            for w in range(size):
                k = at(start + w)
                if k > 0:
                    for i in range(b):
                        t = work[w, i, last]
                        for j in range(b):
                            t -= work[w, i, j] * out[at(k - 1), j]
                        work[w, i, last] = t
                for c in range(b):
                    pivot = c
                    for i in range(c + 1, b):
                        if np.abs(work[w, i, b + c]) > np.abs(work[w, at(pivot), b + c]):
                            pivot = i
                    for j in range(b + c, last + 1):
                        t = work[w, c, j]
                        work[w, c, j] = work[w, at(pivot), j]
                        work[w, at(pivot), j] = t
                    f = 1.0 / work[w, c, b + c]
                    for i in range(c + 1, b):
                        t = work[w, i, b + c] * f
                        for j in range(b + c, last + 1):
                            work[w, i, j] -= t * work[w, c, j]
                for c in range(b - 1, -1, -1):
                    t = work[w, c, last]
                    for j in range(c + 1, b):
                        t -= work[w, c, b + j] * out[k, j]
                    out[k, c] = t / work[w, c, b + c]

    return Kernel(run, "f4 f2 f2 f3")
