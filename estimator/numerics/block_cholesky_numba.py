"""Symmetric positive definite block-tridiagonal systems in one sweep along the chain, compiled.

The same interface as `eliminate`, which does without a compiler: there a Python loop over blocks
would cost a hundred times the arithmetic. Compiled, the plain order of elimination is several times as fast.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from daq import FloatArray
from estimator.numerics.block_tridiagonal import BlockTridiagonal, padded
from estimator.numerics.jit import at, compiled


@dataclass(frozen=True)
class Swept:
    """H = U^T U of a chain's H, and U^-T times its right sides.

    `chain` holds, in the place of H[k, k], the right sides and H[k, k+1]: the upper triangular block U[k, k] with the
    reciprocals of its diagonal in its diagonal, what became of the right sides, and U[k, k+1].
    """

    chain: BlockTridiagonal

    def product(self) -> FloatArray:
        """rhs^T H^-1 rhs (m, m)."""
        half = self.chain.flat_right()
        return np.asarray(half.T @ half)

    def solution(self, weights: FloatArray) -> FloatArray:
        """H^-1 rhs weights (N, b) for weights (m,)."""
        c = self.chain
        out = np.empty((len(c.rows), c.block))
        _back(c.block)(c.rows, c.edge, weights, out)
        return out

    def log_determinant(self) -> float:
        """log det H."""
        c = self.chain
        return float(-2.0 * np.sum(np.log(np.einsum("kii->ki", c.rows[:, :, : c.block]))))

    def inverse_diagonal(self) -> FloatArray:
        """Blocks P[k, k] (N, b, b) of P = H^-1."""
        c = self.chain
        out = np.empty((len(c.rows), c.block, c.block))
        _inverse(c.block)(c.rows, c.edge, padded(c.block), out)
        return out


def eliminate(chain: BlockTridiagonal) -> Swept:
    """Factor H and go forward through the right sides, in the place of both.

    Raises numpy.linalg.LinAlgError where H is not positive definite.
    """
    count, b, full = chain.rows.shape
    if not _forward(b)(chain.rows.reshape(count, b * full), full, chain.edge):
        raise np.linalg.LinAlgError("a block is not positive definite")
    return Swept(chain)


@cache
def _forward(b: int) -> Callable[..., Any]:
    """Factor and forward substitution for blocks of size b, which is a constant to the compiler."""

    def run(flat: Any, full: int, edge: int) -> bool:
        row, done, inverse = np.zeros((b, full)), np.zeros((b, edge)), np.zeros(b)
        line = row.reshape(b * full)  # copied as one: for short lines the compiler copies number by number
        for k in range(flat.shape[0]):
            for c in range(b * full):
                line[c] = flat[k, c]
            for i in range(b):  # what is left of this block after the one before is gone
                for c in range(edge):
                    t = row[i, c]
                    for h in range(b):
                        t -= done[h, i] * done[h, c]
                    row[i, c] = t
            for i in range(b):
                if not row[i, i] > 0.0:
                    return False
                inverse[i] = 1.0 / row[i, i]
                for h in range(i + 1, b):
                    f = row[i, h] * inverse[i]
                    for c in range(full):
                        row[h, c] -= f * row[i, c]
            for i in range(b):  # roots afterwards: the next pivot need not wait for them
                f = np.sqrt(inverse[i])
                for c in range(full):
                    row[i, c] *= f
                row[i, i] = f
            for c in range(b * full):
                flat[k, c] = line[c]
            for i in range(b):
                for c in range(b, edge):
                    done[i, c] = row[i, c]
                for c in range(b):
                    done[i, c] = row[i, edge + c]
        return True

    return compiled(run)


@cache
def _back(b: int) -> Callable[..., Any]:
    """Backward substitution of a combination of the right sides."""

    def run(rows: Any, edge: int, weights: Any, out: Any) -> None:
        x, t = np.zeros(b), np.zeros(b)
        for k in range(rows.shape[0] - 1, -1, -1):
            here = at(k)
            for i in range(b):
                f = 0.0
                for j in range(weights.size):
                    f += rows[here, i, b + j] * weights[j]
                for j in range(b):
                    f -= rows[here, i, edge + j] * x[j]
                t[i] = f
            for i in range(b - 1, -1, -1):
                f = t[i] * rows[here, i, i]
                for j in range(i):
                    t[j] -= rows[here, j, i] * f
                x[i] = f
            for i in range(b):
                out[here, i] = x[i]

    return compiled(run)


@cache
def _inverse(b: int) -> Callable[..., Any]:
    """P[k, k] = V V^T + (V S) P[k+1, k+1] (V S)^T with V = U[k, k]^-1 and S = U[k, k+1]."""

    def run(rows: Any, edge: int, wide: int, out: Any) -> None:
        v, vs, a, p = np.zeros((b, wide)), np.zeros((b, wide)), np.zeros((b, wide)), np.zeros((b, wide))
        v_turned, vs_turned = np.zeros((b, wide)), np.zeros((b, wide))
        for k in range(rows.shape[0] - 1, -1, -1):
            here = at(k)
            for i in range(b - 1, -1, -1):
                for j in range(b):
                    v[i, j] = 0.0
                    vs[i, j] = rows[here, i, edge + j]
                v[i, i] = 1.0
                for h in range(i + 1, b):
                    f = rows[here, i, h]
                    for j in range(wide):
                        v[i, j] -= f * v[h, j]
                        vs[i, j] -= f * vs[h, j]
                f = rows[here, i, i]
                for j in range(wide):
                    v[i, j] *= f
                    vs[i, j] *= f
            for i in range(b):
                for j in range(wide):
                    t = 0.0
                    for h in range(b):
                        t += vs[i, h] * p[h, j]
                    a[i, j] = t
                for j in range(b):
                    v_turned[j, i] = v[i, j]
                    vs_turned[j, i] = vs[i, j]
            for i in range(b):
                for j in range(wide):
                    t = 0.0
                    for h in range(b):
                        t += v[i, h] * v_turned[h, j] + a[i, h] * vs_turned[h, j]
                    p[i, j] = t
                for j in range(b):
                    out[here, i, j] = p[i, j]

    return compiled(run)
