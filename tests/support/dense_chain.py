"""A block tridiagonal chain as one matrix."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.numerics import BlockTridiagonal


def dense(chain: BlockTridiagonal) -> FloatArray:
    """(N b, N b) of a chain."""
    count, b, _ = chain.diagonal.shape
    out = np.zeros((count, b, count, b))
    for k in range(count):
        out[k, :, k] = chain.diagonal[k]
    for k in range(count - 1):
        out[k + 1, :, k], out[k, :, k + 1] = chain.lower[k], chain.lower[k].T
    return out.reshape(count * b, count * b)
