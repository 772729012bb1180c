"""Windows of a record, and statistics over them that a few bad windows do not change.

An impact, a torque step or a gap spoils the windows in which it falls. These have a bounded weight in what is fitted to
all windows, and a noise level of their own in what judges the fit.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from daq import FloatArray

CLEAR = 2.5
"""A remedy must leave so many times less than the records as they are. (On two real arms, an axis and a servo the right
ones leave 2.9 to 7.8 times less in 17 spoilt sets, the best of wrong ones 2.2 times less in 25 right sets.)"""
PASSES = 8
"""Of least squares with new weights."""


def cut(x: FloatArray, length: int) -> FloatArray:
    """(W, length, ...) windows of x (n, ...) without overlap; the last samples that fill none are left out."""
    count = len(x) // length
    return x[: count * length].reshape(count, length, *x.shape[1:])


def usual(squares: FloatArray) -> float:
    """Median of the larger half of squares (W,), above zero: joints may rest in the other half."""
    return max(float(np.quantile(squares, 0.75)), 1e-12 * float(np.max(squares)), 1e-300)


def typical(residuals: FloatArray, power: FloatArray) -> float:
    """Geometric mean of the residuals (W,) over the half of the windows with the most `power` (W,).

    Its logarithm is the likelihood, to a constant, of windows that have noise levels of their own: one that nothing
    explains counts alike for every reading. Windows at rest, which agree with every reading, are left out.
    """
    moving = residuals[power >= np.median(power)]
    return float(np.exp(np.mean(np.log(np.maximum(moving, 1e-12)))))


def bounded(squares: Callable[[FloatArray], FloatArray], leverage: FloatArray) -> FloatArray:
    """(W,) weights of least squares in which no window counts for much more than the usual one, by Cauchy's law.

    `squares` gives the residual's squares (W,) of the solution by weights (W,); `leverage` (W,) is the size of each
    window's equations over the usual one.
    """
    first = 1.0 / np.maximum(leverage, 1.0)
    weights = first
    for _ in range(PASSES):
        left = squares(weights)
        weights = first / (1.0 + left / max(float(np.median(left)), 1e-300))
    return weights


def inverse(gram: FloatArray, ridge: float = 1e-12) -> FloatArray:
    """(..., k, k) inverse of a Gram matrix, with a ridge on its diagonal in units in which that is one."""
    scale = np.sqrt(np.maximum(np.einsum("...aa->...a", gram), 1e-300))
    units = scale[..., :, None] * scale[..., None, :]
    return np.asarray(np.linalg.inv(gram / units + ridge * np.eye(gram.shape[-1])) / units)
