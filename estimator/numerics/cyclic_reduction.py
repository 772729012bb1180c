"""Symmetric positive definite block-tridiagonal systems: Cholesky in odd-even order, solves, the inverse's diagonal.

Every other block is eliminated, which leaves a chain of half the length, and so on until what is left is small
enough for one dense matrix. The blocks of a level do not touch each other, so a level is a few products of many
small matrices: cost grows linearly with the number of blocks, and Python loops only over levels, and over pieces
of a level that fit into the processor's cache.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtrtri

from daq import FloatArray
from estimator.numerics.block_tridiagonal import BlockTridiagonal

PIECE = 1024
"""Blocks that are worked on at a time."""
DENSE = 16
"""Blocks that are taken as one dense matrix."""


@dataclass(frozen=True)
class Level:
    """What eliminating the odd blocks of one chain leaves; H[o, o] = L L^T."""

    blocks: int
    """Length of the chain before."""
    inverse: FloatArray
    """(odd, b, b) L^-1"""
    left: FloatArray
    """(odd, b, b) L^-1 H[o, o-1]"""
    right: FloatArray
    """(inner, b, b) L^-1 H[o, o+1], for all but a last odd block that ends the chain"""

    def pieces(self) -> Iterator[tuple[slice, slice, slice, slice]]:
        """Odd blocks; those of them with a right neighbour; these counted within the piece; the right neighbours.

        Left neighbours among the even blocks have the odd block's own number.
        """
        odd, inner = len(self.left), len(self.right)
        for start in range(0, odd, PIECE):
            stop = min(start + PIECE, inner)
            yield slice(start, min(start + PIECE, odd)), slice(start, stop), slice(stop - start), \
                slice(start + 1, stop + 1)


@dataclass(frozen=True)
class Factor:
    """H = C C^T with C triangular in the order of elimination."""

    levels: tuple[Level, ...]
    last: FloatArray
    """(c, c) L^-1 of what remains."""
    block: int


@dataclass(frozen=True)
class Halves:
    """C^-1 rhs, in the order of elimination."""

    levels: tuple[FloatArray, ...]
    """(odd, b, m) each"""
    last: FloatArray
    """(c, m)"""

    def product(self) -> FloatArray:
        """rhs^T H^-1 rhs (m, m)."""
        total: FloatArray = self.last.T @ self.last
        for y in self.levels:
            flat = y.reshape(-1, y.shape[2])
            total = total + flat.T @ flat
        return total

    def combine(self, weights: FloatArray) -> Halves:
        """C^-1 rhs weights for weights (m, w)."""
        return Halves(tuple(y @ weights for y in self.levels), self.last @ weights)


@dataclass(frozen=True)
class Eliminated:
    """H factored and its right sides half solved: the interface that `block_cholesky_numba` has too."""

    factor: Factor
    halves: Halves

    def product(self) -> FloatArray:
        """rhs^T H^-1 rhs (m, m)."""
        return self.halves.product()

    def solution(self, weights: FloatArray) -> FloatArray:
        """H^-1 rhs weights (N, b) for weights (m,)."""
        return finish(self.factor, self.halves.combine(weights[:, None])).reshape(-1, self.factor.block)

    def log_determinant(self) -> float:
        """log det H."""
        roots = [np.einsum("kii->ki", level.inverse).ravel() for level in self.factor.levels]
        return float(-2.0 * np.sum(np.log(np.concatenate([*roots, np.diag(self.factor.last)]))))

    def inverse_diagonal(self) -> FloatArray:
        """Blocks P[k, k] (N, b, b) of P = H^-1."""
        return inverse_diagonal(self.factor)


def eliminate(chain: BlockTridiagonal) -> Eliminated:
    """Factor H and go forward through its right sides.

    Raises numpy.linalg.LinAlgError where H is not positive definite.
    """
    factored = factor(chain.diagonal, chain.lower)
    return Eliminated(factored, halve(factored, chain.flat_right()))


def gram(matrices: FloatArray) -> FloatArray:
    """A^T A of each of many small matrices (m, r, c); on A itself numpy takes a routine that is slow on small ones."""
    return np.asarray(matrices.swapaxes(1, 2) @ matrices.copy())


def factor(diagonal: FloatArray, lower: FloatArray) -> Factor:
    """Of H with blocks diagonal (N, b, b) and lower (N-1, b, b) = H[k+1, k].

    Raises numpy.linalg.LinAlgError where H is not positive definite.
    """
    levels = []
    while len(diagonal) > DENSE:
        level, diagonal, lower = _eliminate_odd(diagonal, lower)
        levels.append(level)
    n, b, _ = diagonal.shape
    dense = np.zeros((n, b, n, b))
    k = np.arange(n)
    dense[k, :, k] = diagonal
    dense[k[1:], :, k[:-1]] = lower
    root = np.linalg.cholesky(dense.reshape(n * b, n * b))
    return Factor(tuple(levels), dtrtri(root, lower=1)[0], b)


def _eliminate_odd(diagonal: FloatArray, lower: FloatArray) -> tuple[Level, FloatArray, FloatArray]:
    """The level, and the chain of even blocks that is left."""
    n, b, _ = diagonal.shape
    odd, inner = n // 2, (n - 1) // 2
    level = Level(n, np.empty((odd, b, b)), np.empty((odd, b, b)), np.empty((inner, b, b)))
    even, coupling = diagonal[0::2].copy(), np.empty((inner, b, b))
    middle, to_left, to_right = diagonal[1::2], lower[0::2], lower[1::2].swapaxes(1, 2)
    for here, paired, within, neighbour in level.pieces():
        inverse = level.inverse[here] = _invert_roots(middle[here])
        left = np.matmul(inverse, to_left[here], out=level.left[here])
        right = np.matmul(inverse[within], to_right[paired], out=level.right[paired])
        even[here] -= gram(left)
        even[neighbour] -= gram(right)
        np.negative(right.swapaxes(1, 2) @ left[within], out=coupling[paired])
    return level, even, coupling


def _invert_roots(blocks: FloatArray) -> FloatArray:
    """L^-1 (m, b, b) of each block L L^T, by eliminating in all [block, 1] at once; the last axis is the block."""
    m, b, _ = blocks.shape
    w = np.zeros((b, 2 * b, m))
    w[:, :b] = blocks.transpose(1, 2, 0)
    w[range(b), range(b, 2 * b)] = 1.0
    for k in range(b):
        row = w[k, k : k + b + 1]
        if not row[0].min() > 0.0:
            raise np.linalg.LinAlgError("a block is not positive definite")
        row /= np.sqrt(row[0])
        w[k + 1 :, k + 1 : k + b + 1] -= row[1 : b - k, None] * row[1:]
    return np.ascontiguousarray(w[:, b:].transpose(2, 0, 1))


def halve(factored: Factor, rhs: FloatArray) -> Halves:
    """C^-1 rhs for rhs (N b, m)."""
    r = rhs.reshape(-1, factored.block, rhs.shape[1])
    done = []
    for level in factored.levels:
        middle, r = r[1::2], r[0::2].copy()
        y = np.empty((len(level.left), *r.shape[1:]))
        for here, paired, within, neighbour in level.pieces():
            solved = np.matmul(level.inverse[here], middle[here], out=y[here])
            r[here] -= level.left[here].swapaxes(1, 2) @ solved
            r[neighbour] -= level.right[paired].swapaxes(1, 2) @ solved[within]
        done.append(y)
    return Halves(tuple(done), factored.last @ r.reshape(len(factored.last), -1))


def finish(factored: Factor, halves: Halves) -> FloatArray:
    """H^-1 rhs (N b, m) from C^-1 rhs."""
    b, m = factored.block, halves.last.shape[1]
    x = (factored.last.T @ halves.last).reshape(-1, b, m)
    for level, y in zip(factored.levels[::-1], halves.levels[::-1]):
        out = np.empty((level.blocks, b, m))
        out[0::2] = x
        for here, paired, within, neighbour in level.pieces():
            rest = y[here] - level.left[here] @ x[here]
            rest[within] -= level.right[paired] @ x[neighbour]
            np.matmul(level.inverse[here].swapaxes(1, 2), rest, out=out[1::2][here])
        x = out
    return x.reshape(-1, m)


def inverse_diagonal(factored: Factor) -> FloatArray:
    """Blocks P[k, k] (N, b, b) of P = H^-1.

    Those of an odd block o follow from those of its neighbours l and r: with G = L^-T L^-1 H[o, .],
    P[o, l] = -G_l P[l, l] - G_r P[r, l], and P[o, o] = L^-T L^-1 - P[o, l] G_l^T - P[o, r] G_r^T.
    """
    b = factored.block
    n = len(factored.last) // b
    dense, k = (factored.last.T @ factored.last).reshape(n, b, n, b), np.arange(n)
    diagonal, lower = dense[k, :, k], dense[k[1:], :, k[:-1]]  # P[k, k], P[k+1, k]
    for level in factored.levels[::-1]:
        out, out_lower = np.empty((level.blocks, b, b)), np.empty((level.blocks - 1, b, b))
        out[0::2] = diagonal
        for here, paired, within, neighbour in level.pieces():
            inverse = level.inverse[here]
            back = inverse.swapaxes(1, 2)
            to_left, to_right = back @ level.left[here], back[within] @ level.right[paired]
            by_left = to_left @ diagonal[here]
            by_left[within] += to_right @ lower[paired]
            by_right = lower[paired] @ to_left[within].swapaxes(1, 2)
            by_right += diagonal[neighbour] @ to_right.swapaxes(1, 2)
            own = gram(inverse)
            own += by_left @ to_left.swapaxes(1, 2)
            own[within] += by_right.swapaxes(1, 2) @ to_right.swapaxes(1, 2)
            out[1::2][here] = own
            np.negative(by_left, out=out_lower[0::2][here])
            np.negative(by_right, out=out_lower[1::2][paired])
        diagonal, lower = out, out_lower
    return diagonal
