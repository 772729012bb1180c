"""Symmetric block-tridiagonal systems: banded Cholesky solves and the inverse's own band.

Cost grows linearly with the number of blocks; nothing here loops over blocks in Python except to halve them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

FloatArray = NDArray[np.float64]


def to_banded(diagonal: FloatArray, lower: FloatArray) -> FloatArray:
    """LAPACK lower-banded storage (2b, N b) of blocks diagonal (N, b, b) and lower (N-1, b, b) = H[k+1, k]."""
    n, b, _ = diagonal.shape
    band = np.zeros((2 * b, n * b))
    for j in range(b):
        for i in range(j, b):
            band[i - j, j::b] = diagonal[:, i, j]
        for i in range(b):
            band[b + i - j, j : (n - 1) * b : b] = lower[:, i, j]
    return band


def factor(diagonal: FloatArray, lower: FloatArray) -> FloatArray:
    """Banded Cholesky factor for `solve`. Raises numpy.linalg.LinAlgError where H is not positive definite."""
    factored = cholesky_banded(to_banded(diagonal, lower), overwrite_ab=True, lower=True, check_finite=False)
    return np.asarray(factored, dtype=np.float64)


def solve(factored: FloatArray, rhs: FloatArray) -> FloatArray:
    """H^-1 rhs for rhs (N b,) or (N b, m)."""
    return np.asarray(cho_solve_banded((factored, True), rhs, check_finite=False), dtype=np.float64)


def inverse_band(diagonal: FloatArray, lower: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Blocks P[k, k] (N, b, b) and P[k+1, k] (N-1, b, b) of P = H^-1, by cyclic (odd-even) reduction.

    Odd blocks are eliminated, the half-sized system of even blocks is inverted the same way, and the odd
    rows follow from P[o, e] = -D_o^-1 (L_o P[o-1, e] + L_{o+1}^T P[o+1, e]).
    """
    n = diagonal.shape[0]
    if n == 1:
        return np.asarray(np.linalg.inv(diagonal), dtype=np.float64), lower[:0]
    odd = np.arange(1, n, 2)
    below = lower[odd - 1]  # H[o, o-1]
    above = np.zeros_like(below)  # H[o, o+1]
    inner = odd < n - 1
    above[inner] = np.swapaxes(lower[odd[inner]], -1, -2)
    inverse = np.linalg.inv(diagonal[odd])
    inverse = 0.5 * (inverse + np.swapaxes(inverse, -1, -2))
    to_left, to_right = inverse @ below, inverse @ above  # D_o^-1 H[o, o-1], D_o^-1 H[o, o+1]
    even = diagonal[0::2].copy()
    even[: odd.shape[0]] -= np.swapaxes(below, -1, -2) @ to_left
    right = np.flatnonzero(inner)
    even[right + 1] -= np.swapaxes(above[right], -1, -2) @ to_right[right]
    coupling = -np.swapaxes(above[right], -1, -2) @ to_left[right]  # H'[e+1, e]
    p_even, p_next = inverse_band(even, coupling)

    p_diag = np.empty_like(diagonal)
    p_diag[0::2] = p_even
    p_left = -to_left @ p_even[: odd.shape[0]]  # P[o, o-1]
    p_left[right] -= to_right[right] @ p_next
    p_right = -to_right[right] @ p_even[right + 1] - to_left[right] @ np.swapaxes(p_next, -1, -2)  # P[o, o+1]
    p_odd = inverse - p_left @ np.swapaxes(to_left, -1, -2)
    p_odd[right] -= p_right @ np.swapaxes(to_right[right], -1, -2)
    p_diag[1::2] = 0.5 * (p_odd + np.swapaxes(p_odd, -1, -2))
    p_lower = np.empty_like(lower)
    p_lower[odd - 1] = p_left
    p_lower[odd[inner]] = np.swapaxes(p_right, -1, -2)
    return p_diag, p_lower
