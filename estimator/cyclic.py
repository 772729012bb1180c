"""Symmetric positive definite block-tridiagonal systems by cyclic (odd-even) reduction, all blocks at once.

Blocks stand first and the chain's index last, (b, b, N): every step is one array operation over half of the
chain, so no Python loop runs over blocks. Odd blocks are eliminated, the half-sized system of even blocks is
treated the same way, and the odd unknowns follow. Several independent chains are one chain whose couplings
between them are zero.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
PIECE = 2048
"""Blocks multiplied at a time: what stays in a core's cache."""


class Level(NamedTuple):
    """One halving of the chain; o counts the odd blocks."""

    inverse: FloatArray
    """(b, b, o) inverse of the odd diagonal blocks."""
    left: FloatArray
    """(b, b, o) that inverse times H[o, o-1]."""
    right: FloatArray
    """(b, b, r) that inverse times H[o, o+1]; r = o, or o - 1 where the chain ends on an odd block."""


class Factor(NamedTuple):
    """What `solve` and `inverse_band` need of a matrix."""

    levels: list[Level]
    last: FloatArray
    """(b, b, 1) inverse of the one block that is left."""
    scale: FloatArray
    """(b, N) by which rows and columns were divided: one over the root of the diagonal."""


def multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products of a (i, j, K) and b (j, k, K) over K: (i, k, K)."""
    count = a.shape[-1]
    out = np.empty((a.shape[0], b.shape[1], count))
    for start in range(0, count, PIECE):
        piece = slice(start, start + PIECE)
        np.einsum("ijK,jkK->ikK", a[..., piece], b[..., piece], out=out[..., piece])
    return out


def multiply_transposed(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products of the transposes of a (j, i, K) with b (j, k, K): (i, k, K)."""
    return multiply(a.swapaxes(0, 1), b)


def invert(blocks: FloatArray) -> FloatArray:
    """Inverses of symmetric positive definite blocks (b, b, K), by sweeping. Raises numpy.linalg.LinAlgError."""
    a = blocks.copy()
    for k in range(a.shape[0]):
        pivot = a[k, k].copy()
        if not np.all(pivot > 0.0):
            raise np.linalg.LinAlgError("a block is not positive definite")
        row = a[k] / pivot
        column = a[:, k].copy()
        a -= column[:, None] * row[None]
        a[:, k] = column / pivot
        a[k] = row
        a[k, k] = -1.0 / pivot
    return -a


def factor(diagonal: FloatArray, lower: FloatArray) -> Factor:
    """Reduce H with blocks diagonal (b, b, N) and lower (b, b, N-1) = H[k+1, k]. Raises numpy.linalg.LinAlgError."""
    scale = np.einsum("iiK->iK", diagonal)
    if not np.all(scale > 0.0):
        raise np.linalg.LinAlgError("the diagonal is not positive")
    scale = 1.0 / np.sqrt(scale)
    diagonal = diagonal * scale[:, None] * scale[None]
    lower = lower * scale[:, None, 1:] * scale[None, :, :-1]
    levels = []
    while diagonal.shape[-1] > 1:
        inverse = invert(diagonal[..., 1::2])
        below = np.ascontiguousarray(lower[..., 0::2])  # H[o, o-1]
        above = np.ascontiguousarray(lower[..., 1::2].swapaxes(0, 1))  # H[o, o+1]
        inner = above.shape[-1]
        left, right = multiply(inverse, below), multiply(inverse[..., :inner], above)
        even = np.ascontiguousarray(diagonal[..., 0::2])
        even[..., : below.shape[-1]] -= multiply_transposed(below, left)
        even[..., 1:] -= multiply_transposed(above, right)[..., : even.shape[-1] - 1]
        lower = -multiply_transposed(above, left[..., :inner])
        diagonal = even
        levels.append(Level(inverse, left, right))
    return Factor(levels, invert(diagonal), scale)


def solve(factored: Factor, rhs: FloatArray) -> FloatArray:
    """H^-1 rhs for rhs (b, m, N)."""
    rhs = rhs * factored.scale[:, None]
    kept = []
    for level in factored.levels:
        odd = rhs[..., 1::2]
        inner = level.right.shape[-1]
        even = np.ascontiguousarray(rhs[..., 0::2])
        even[..., : level.left.shape[-1]] -= multiply_transposed(level.left, odd)
        even[..., 1:] -= multiply_transposed(level.right, odd[..., :inner])
        kept.append(multiply(level.inverse, odd))
        rhs = even
    x = multiply(factored.last, rhs)
    for level, own in zip(reversed(factored.levels), reversed(kept)):
        inner = level.right.shape[-1]
        own -= multiply(level.left, x[..., : own.shape[-1]])
        own[..., :inner] -= multiply(level.right, x[..., 1:])
        x = _interleave(x, own)
    return x * factored.scale[:, None]


def inverse_band(factored: Factor) -> tuple[FloatArray, FloatArray]:
    """Blocks P[k, k] (b, b, N) and P[k+1, k] (b, b, N-1) of P = H^-1.

    P[o, e] = -(left P[o-1, e] + right P[o+1, e]), P[o, o] = inverse - P[o, o-1] left^T - P[o, o+1] right^T.
    """
    p_diagonal = factored.last
    p_lower = np.empty((*p_diagonal.shape[:2], 0))
    for level in reversed(factored.levels):
        count, inner = level.left.shape[-1], level.right.shape[-1]
        p_left = -multiply(level.left, p_diagonal[..., :count])
        p_left[..., :inner] -= multiply(level.right, p_lower[..., :inner])
        p_right = -multiply(level.right, p_diagonal[..., 1 : inner + 1])
        p_right -= multiply(level.left[..., :inner], p_lower[..., :inner].swapaxes(0, 1))
        own = level.inverse - multiply(p_left, level.left.swapaxes(0, 1))
        own[..., :inner] -= multiply(p_right, level.right.swapaxes(0, 1))
        p_lower = _interleave(p_left, p_right.swapaxes(0, 1))
        p_diagonal = _interleave(p_diagonal, own)
    scale = factored.scale
    p_diagonal = p_diagonal * scale[:, None] * scale[None]
    return p_diagonal, p_lower * scale[:, None, 1:] * scale[None, :, :-1]


def _interleave(even: FloatArray, odd: FloatArray) -> FloatArray:
    out = np.empty((*even.shape[:-1], even.shape[-1] + odd.shape[-1]))
    out[..., 0::2], out[..., 1::2] = even, odd
    return out
