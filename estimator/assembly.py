"""Sums of the normal equations from rows of the Jacobian: by products of many small matrices, or compiled.

Rows come with the sample last, as arrays over samples make them; the normal equations have it first, as elimination
wants them. Compiled, one pass turns a few samples at a time and sums their products without anything in between.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.oddeven import gram

FloatArray = NDArray[np.float64]
Samples = slice | NDArray[np.intp]
STRIP = 8
"""Samples that are turned at a time, a line of the processor's cache; rows are padded with zeros to a multiple."""


def padded(count: int) -> int:
    """The next multiple of STRIP."""
    return -(-count // STRIP) * STRIP


class Sums(NamedTuple):
    """Where normal equations are summed up."""

    diagonal: FloatArray
    """(N, b, b)"""
    lower: FloatArray
    """(N-1, b, b)"""
    right: FloatArray
    """(N, b, w)"""


def add_intervals(rows: FloatArray, here: Samples, there: Samples, sums: Sums, fast: bool) -> None:
    """Add rows (r, 2 b + w, padded K) of intervals from samples `here` to `there`: latents at both ends, w columns."""
    height, width, _ = rows.shape
    b = sums.diagonal.shape[1]
    if fast:
        left = np.arange(here.start, here.stop) if isinstance(here, slice) else here
        _intervals(b, height)(rows.reshape(height, width, -1, STRIP), left, *sums)
        return
    turned = _turned(rows)[: len(sums.diagonal[here])]
    before, after, rest = turned[:, :, :b], turned[:, :, b : 2 * b], turned[:, :, 2 * b :]
    sums.diagonal[here] += gram(before)
    sums.diagonal[there] += gram(after)
    sums.lower[here] = after.swapaxes(1, 2) @ before
    sums.right[here] += before.swapaxes(1, 2) @ rest
    sums.right[there] += after.swapaxes(1, 2) @ rest


def add_samples(rows: FloatArray, here: slice, weight: float, sums: Sums, turned: FloatArray, fast: bool) -> None:
    """Add `weight` times the products of rows (r, b + w, padded K) of samples `here`, put into turned (N, r, b + w)."""
    height, width, _ = rows.shape
    b = sums.diagonal.shape[1]
    if fast:
        _samples(b, height)(rows.reshape(height, width, -1, STRIP), here.start, here.stop, weight, sums.diagonal,
                                   sums.right, turned)
        return
    turned[here] = _turned(rows)[: here.stop - here.start]
    own = turned[here, :, :b]
    back = own.swapaxes(1, 2) * weight
    sums.diagonal[here] += back @ own
    sums.right[here] += back @ turned[here, :, b:]


def _turned(rows: FloatArray) -> FloatArray:
    height, width, count = rows.shape
    return rows.reshape(-1, count).T.copy().reshape(count, height, width)


@cache
def _intervals(b: int, height: int) -> Callable[..., Any]:
    """The kernel of `add_intervals` for blocks and rows of these sizes, which are constants to the compiler."""

    def run(rows: Any, left: Any, diagonal: Any, lower: Any, right: Any) -> None:
        width, columns = rows.shape[1], right.shape[2]
        strip, product = np.empty((STRIP, height, width)), np.empty((2 * b, width))
        for t in range(rows.shape[2]):
            for r in range(height):
                for c in range(width):
                    for s in range(STRIP):
                        strip[s, r, c] = rows[r, c, t, s]
            for s in range(min(STRIP, left.size - STRIP * t)):
                for i in range(2 * b):
                    for c in range(width):
                        total = 0.0
                        for r in range(height):
                            total += strip[s, r, i] * strip[s, r, c]
                        product[i, c] = total
                k = np.uint64(left[STRIP * t + s])  # not counted from the end, which the compiler should know
                for i in range(b):
                    for j in range(b):
                        diagonal[k, i, j] += product[i, j]
                        lower[k, i, j] = product[b + i, j]
                    for j in range(columns):
                        right[k, i, j] += product[i, 2 * b + j]
                k = np.uint64(left[STRIP * t + s] + 1)
                for i in range(b):
                    for j in range(b):
                        diagonal[k, i, j] += product[b + i, b + j]
                    for j in range(columns):
                        right[k, i, j] += product[b + i, 2 * b + j]

    return compiled(run)


@cache
def _samples(b: int, height: int) -> Callable[..., Any]:
    """The kernel of `add_samples`."""

    def run(rows: Any, first: int, end: int, weight: float, diagonal: Any, right: Any, turned: Any) -> None:
        width = rows.shape[1]
        strip, product = np.empty((STRIP, height, width)), np.empty((b, width))
        for t in range(rows.shape[2]):
            for r in range(height):
                for c in range(width):
                    for s in range(STRIP):
                        strip[s, r, c] = rows[r, c, t, s]
            for s in range(min(STRIP, end - first - STRIP * t)):
                for i in range(b):
                    for c in range(width):
                        total = 0.0
                        for r in range(height):
                            total += strip[s, r, i] * strip[s, r, c]
                        product[i, c] = total
                k = np.uint64(first + STRIP * t + s)
                for r in range(height):
                    for c in range(width):
                        turned[k, r, c] = strip[s, r, c]
                for i in range(b):
                    for j in range(b):
                        diagonal[k, i, j] += weight * product[i, j]
                    for j in range(width - b):
                        right[k, i, j] += weight * product[i, b + j]

    return compiled(run)
