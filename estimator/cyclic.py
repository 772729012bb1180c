"""Symmetric positive definite block-tridiagonal systems by cyclic (odd-even) reduction, all blocks at once.

Odd blocks are eliminated, the half-sized system of even blocks is treated the same way, and the odd unknowns
follow: every step is one batched product over half of the chain, so no Python loop runs over blocks, and cost
grows linearly. Several independent chains are one chain whose couplings between them are zero.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
PIECE = 512
"""Blocks inverted at a time: what stays in a core's cache."""


class Level(NamedTuple):
    """One halving of the chain; o counts the odd blocks."""

    inverse: FloatArray
    """(o, b, b) inverse of the odd diagonal blocks."""
    left: FloatArray
    """(o, b, b) that inverse times H[o, o-1]."""
    right: FloatArray
    """(r, b, b) that inverse times H[o, o+1]; r = o, or o - 1 where the chain ends on an odd block."""


class Factor(NamedTuple):
    """What `solve` and `inverse_band` need of a matrix."""

    levels: list[Level]
    last: FloatArray
    """(1, b, b) inverse of the one block that is left."""
    scale: FloatArray
    """(N, b) by which rows and columns were multiplied: one over the root of the diagonal."""


def invert(blocks: FloatArray) -> FloatArray:
    """Inverses of symmetric positive definite blocks (K, b, b), by sweeping. Raises numpy.linalg.LinAlgError."""
    out = np.empty(blocks.shape)
    for start in range(0, blocks.shape[0], PIECE):
        out[start : start + PIECE] = _sweep(blocks[start : start + PIECE].transpose(1, 2, 0)).transpose(2, 0, 1)
    return out


def _sweep(blocks: FloatArray) -> FloatArray:
    """Inverses of (b, b, K): Gauss-Jordan without pivoting, which positive definite blocks do not need."""
    a = np.ascontiguousarray(blocks)
    a = a.copy() if a is blocks else a
    for k in range(a.shape[0]):
        pivot = a[k, k].copy()
        if not np.all(pivot > 0.0):
            raise np.linalg.LinAlgError("a block is not positive definite")
        row = a[k] / pivot
        column = a[:, k].copy()
        a -= column[:, None] * row[None]
        a[:, k] = column / -pivot
        a[k] = row
        a[k, k] = 1.0 / pivot
    return a


def factor(diagonal: FloatArray, lower: FloatArray) -> Factor:
    """Reduce H with blocks diagonal (N, b, b) and lower (N-1, b, b) = H[k+1, k]. Raises numpy.linalg.LinAlgError."""
    scale = np.einsum("Nii->Ni", diagonal)
    if not np.all(scale > 0.0):
        raise np.linalg.LinAlgError("the diagonal is not positive")
    scale = 1.0 / np.sqrt(scale)
    diagonal = diagonal * (scale[:, :, None] * scale[:, None, :])
    lower = lower * (scale[1:, :, None] * scale[:-1, None, :])
    levels = []
    while diagonal.shape[0] > 1:
        inverse = invert(diagonal[1::2])
        below, upward = lower[0::2], lower[1::2]  # H[o, o-1], H[o+1, o]
        inner = upward.shape[0]
        left, right = inverse @ below, inverse[:inner] @ upward.swapaxes(1, 2)
        even = diagonal[0::2].copy()
        even[: below.shape[0]] -= below.swapaxes(1, 2) @ left
        even[1:] -= upward @ right
        lower = -(upward @ left[:inner])
        diagonal = 0.5 * (even + even.swapaxes(1, 2))
        levels.append(Level(inverse, left, right))
    return Factor(levels, invert(diagonal), scale)


def solve(factored: Factor, rhs: FloatArray) -> FloatArray:
    """H^-1 rhs for rhs (N, b, m)."""
    rhs = rhs * factored.scale[:, :, None]
    kept = []
    for level in factored.levels:
        odd = rhs[1::2]
        even = rhs[0::2].copy()
        even[: odd.shape[0]] -= level.left.swapaxes(1, 2) @ odd
        even[1:] -= level.right.swapaxes(1, 2) @ odd[: level.right.shape[0]]
        kept.append(level.inverse @ odd)
        rhs = even
    x = factored.last @ rhs
    for level, own in zip(reversed(factored.levels), reversed(kept)):
        own -= level.left @ x[: own.shape[0]]
        own[: level.right.shape[0]] -= level.right @ x[1:]
        x = _interleave(x, own)
    return x * factored.scale[:, :, None]


def inverse_band(factored: Factor) -> tuple[FloatArray, FloatArray]:
    """Blocks P[k, k] (N, b, b) and P[k+1, k] (N-1, b, b) of P = H^-1.

    P[o, e] = -(left P[o-1, e] + right P[o+1, e]), P[o, o] = inverse - P[o, o-1] left^T - P[o, o+1] right^T.
    """
    p_diagonal = factored.last
    p_lower = np.empty((0, *p_diagonal.shape[1:]))
    for level in reversed(factored.levels):
        count, inner = level.left.shape[0], level.right.shape[0]
        p_left = -(level.left @ p_diagonal[:count])
        p_left[:inner] -= level.right @ p_lower
        p_right = -(level.right @ p_diagonal[1 : inner + 1])
        p_right -= level.left[:inner] @ p_lower.swapaxes(1, 2)
        own = level.inverse - p_left @ level.left.swapaxes(1, 2)
        own[:inner] -= p_right @ level.right.swapaxes(1, 2)
        p_lower = _interleave(p_left, p_right.swapaxes(1, 2))
        p_diagonal = _interleave(p_diagonal, own)
    scale = factored.scale
    return (p_diagonal * (scale[:, :, None] * scale[:, None, :]),
            p_lower * (scale[1:, :, None] * scale[:-1, None, :]))


def _interleave(even: FloatArray, odd: FloatArray) -> FloatArray:
    out = np.empty((even.shape[0] + odd.shape[0], *even.shape[1:]))
    out[0::2], out[1::2] = even, odd
    return out
