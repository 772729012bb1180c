"""Levels of channels whose correlation is declared: what one shows says something of the others."""

from __future__ import annotations

import numpy as np

from daq import FloatArray

STEPS = 50
"""Most steps of the search."""
ENOUGH = 1e-12
"""Change of all x that ends it."""


def excess_variance(declared: FloatArray, found: FloatArray) -> FloatArray:
    """(m,) maximum-likelihood variance of each of m correlated channels over its own mean square.

    At a given correlation R, `declared` (m, m), the likeliest levels solve diag(R^-1 D^-1 S D^-1) = 1 for D, S the mean
    products of the channels. With x the root mean squares over the levels, x_i (A x)_i = 1, where A is the product of
    R^-1 with the correlation `found` (m, m), entry by entry: the minimum of x^T A x / 2 - sum log x. It is 1 where both
    correlations are the same. Where A is not definite the channels count as independent.
    """
    a = np.linalg.inv(declared) * found
    x = np.ones(len(a))
    if np.linalg.eigvalsh(a)[0] <= 0.0:
        return x
    for _ in range(STEPS):
        slope = a @ x - 1.0 / x
        step = -np.linalg.solve(a + np.diag(x**-2), slope)
        x = x + step * min(1.0, 0.5 / float(np.max(np.abs(step / x), initial=1e-300)))
        if np.max(np.abs(step)) < ENOUGH:
            break
    return np.asarray(x**-2)


def correlation_of(products: FloatArray, counts: FloatArray) -> FloatArray:
    """(m, m) from sums of products (m, m) over so many samples each (m, m)."""
    mean = products / np.maximum(counts, 1e-300)
    size = np.sqrt(np.maximum(np.diag(mean), 1e-300))
    return np.asarray(mean / np.outer(size, size))
