"""Block lower bidiagonal systems, one step after the other, compiled: what an implicit integrator solves."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.numerics.kernel import at, compile_kernel

STRIP = 32
"""Blocks that are put in one place at a time."""


def solve_bidiagonal(blocks: FloatArray, right: FloatArray) -> FloatArray:
    """x (K, b) of L[k] x[k-1] + A[k] x[k] = right[k], x[-1] = 0; blocks (b, 2, b, K) hold L and A, right is (b, K).

    Rows are exchanged within a block. Raises numpy.linalg.LinAlgError where a block is singular or not finite.
    """
    b, count = right.shape
    out = np.zeros((count + 1, b, 1))
    propagate(blocks, right[:, None], np.arange(count), out)
    if not np.isfinite(out).all():
        raise np.linalg.LinAlgError("a block is singular")
    return out[1:, :, 0]


def propagate(blocks: FloatArray, right: FloatArray, left: NDArray[np.int64], x: FloatArray) -> None:
    """Fill x (N, b, m) from L[k] x[left[k]] + A[k] x[left[k] + 1] = right[k] for each interval k in turn.

    `blocks` (b, 2, b, K) hold L and A, `right` is (b, m, K), `left` (K,) rises; rows of x that end no interval are
    given. What follows a singular block is not finite.
    """
    b, m, _ = right.shape
    _substitute(b)(np.ascontiguousarray(blocks), np.ascontiguousarray(right), np.asarray(left, dtype=np.int64), x,
                   np.zeros((STRIP, b, 2 * b + m)))


@cache
def _substitute(b: int) -> Callable[..., None]:
    """The kernel for blocks of size b; work (STRIP, b, 2 b + m) is zeros."""

    def run(blocks: Any, right: Any, left: Any, x: Any, work: Any) -> None:
        count, last = left.shape[0], 2 * b
        end = last + right.shape[1]
        for start in range(0, count, STRIP):
            size = min(STRIP, count - start)
            for i in range(b):
                for j in range(b):
                    for w in range(size):
                        work[w, i, j] = blocks[i, 0, j, at(start + w)]
                        work[w, i, b + j] = blocks[i, 1, j, at(start + w)]
                for c in range(last, end):
                    for w in range(size):
                        work[w, i, c] = right[i, c - last, at(start + w)]
            for w in range(size):
                k = at(left[start + w])
                for i in range(b):
                    for c in range(last, end):
                        t = work[w, i, c]
                        for j in range(b):
                            t -= work[w, i, j] * x[k, j, c - last]
                        work[w, i, c] = t
                for c in range(b):
                    pivot = c
                    for i in range(c + 1, b):
                        if np.abs(work[w, i, b + c]) > np.abs(work[w, at(pivot), b + c]):
                            pivot = i
                    for j in range(b + c, end):
                        t = work[w, c, j]
                        work[w, c, j] = work[w, at(pivot), j]
                        work[w, at(pivot), j] = t
                    f = 1.0 / work[w, c, b + c]
                    for i in range(c + 1, b):
                        t = work[w, i, b + c] * f
                        for j in range(b + c, end):
                            work[w, i, j] -= t * work[w, c, j]
                for r in range(last, end):
                    for c in range(b - 1, -1, -1):
                        t = work[w, c, r]
                        for j in range(c + 1, b):
                            t -= work[w, c, b + j] * x[k + at(1), j, r - last]
                        x[k + at(1), c, r - last] = t / work[w, c, b + c]

    return compile_kernel(run, "f4 f3 i1 f3 f3")
