"""Symmetric positive definite block-tridiagonal systems in one sweep along the chain, compiled.

Cost grows linearly with the number of blocks. A Python loop over them would cost a hundred times the arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from daq import FloatArray
from estimator.numerics.block_tridiagonal import BlockTridiagonal, padded
from estimator.numerics.kernel import at, compile_kernel


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
        _back(c.block)(c.rows, c.edge, np.ascontiguousarray(weights), out, np.zeros((2, c.block)))
        return out

    def solutions(self) -> FloatArray:
        """H^-1 rhs (N, b, m)."""
        return np.stack([self.solution(each) for each in np.eye(self.chain.width)], axis=-1)

    def log_determinant(self) -> float:
        """log det H."""
        c = self.chain
        return float(-2.0 * np.sum(np.log(np.einsum("kii->ki", c.rows[:, :, : c.block]))))

    def inverse_diagonal(self) -> FloatArray:
        """Blocks P[k, k] (N, b, b) of P = H^-1."""
        return self._inverse_blocks(False)[0]

    def inverse_blocks(self) -> tuple[FloatArray, FloatArray]:
        """Blocks P[k, k] (N, b, b) and P[k, k+1] (N-1, b, b) of P = H^-1."""
        diagonal, upper = self._inverse_blocks(True)
        return diagonal, upper[:-1]

    def _inverse_blocks(self, both: bool) -> tuple[FloatArray, FloatArray]:
        c = self.chain
        out = np.empty((len(c.rows), c.block, c.block))
        upper = np.empty_like(out) if both else np.empty((0, c.block, c.block))
        wide = padded(c.block)
        _inverse(c.block)(c.rows, c.edge, wide, out, upper, np.zeros((6, c.block, wide)))
        return out, upper


def eliminate(chain: BlockTridiagonal) -> Swept:
    """Factor H and go forward through the right sides, in the place of both.

    Raises numpy.linalg.LinAlgError where H is not positive definite.
    """
    count, b, full = chain.rows.shape
    definite = np.ones(1, dtype=np.int64)
    _forward(b)(chain.rows.reshape(count, b * full), full, chain.edge, definite, np.zeros((b, full)),
                np.zeros((b, chain.edge)), np.zeros(b))
    if not definite[0]:
        raise np.linalg.LinAlgError("a block is not positive definite")
    return Swept(chain)


@cache
def _forward(b: int) -> Callable[..., None]:
    """Factor and forward substitution for blocks of size b, which is a constant to the compiler.

    `definite` becomes zero, and the rest stays as it is, where a block is not; row (b, full), done (b, edge) and
    inverse (b,) are zeros to work on.
    """

    def run(flat: Any, full: int, edge: int, definite: Any, row: Any, done: Any, inverse: Any) -> None:
        for k in range(flat.shape[0]):
            for i in range(b):
                for c in range(full):
                    row[i, c] = flat[k, i * full + c]
            for i in range(b):  # what is left of this block after the one before is gone
                for c in range(edge):
                    t = row[i, c]
                    for h in range(b):
                        t -= done[h, i] * done[h, c]
                    row[i, c] = t
            for i in range(b):
                if not row[i, i] > 0.0:
                    definite[0] = 0
                    return
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
            for i in range(b):
                for c in range(full):
                    flat[k, i * full + c] = row[i, c]
            for i in range(b):
                for c in range(b, edge):
                    done[i, c] = row[i, c]
                for c in range(b):
                    done[i, c] = row[i, edge + c]

    return compile_kernel(run, "f2 n n i1 f2 f2 f1")


@cache
def _back(b: int) -> Callable[..., None]:
    """Backward substitution of a combination of the right sides; work (2, b) is zeros."""

    def run(rows: Any, edge: int, weights: Any, out: Any, work: Any) -> None:
        for k in range(rows.shape[0] - 1, -1, -1):
            here = at(k)
            for i in range(b):
                f = 0.0
                for j in range(weights.size):
                    f += rows[here, i, b + j] * weights[j]
                for j in range(b):
                    f -= rows[here, i, edge + j] * work[0, j]
                work[1, i] = f
            for i in range(b - 1, -1, -1):
                f = work[1, i] * rows[here, i, i]
                for j in range(i):
                    work[1, j] -= rows[here, j, i] * f
                work[0, i] = f
            for i in range(b):
                out[here, i] = work[0, i]

    return compile_kernel(run, "f3 n f1 f2 f2")


@cache
def _inverse(b: int) -> Callable[..., None]:
    """P[k, k+1] = -(V S) P[k+1, k+1], P[k, k] = V V^T - P[k, k+1] (V S)^T with V = U[k, k]^-1 and S = U[k, k+1].

    `upper` (N, b, b), or (0, b, b) where it is not wanted, gets P[k, k+1]; work (6, b, wide) is zeros.
    """

    def run(rows: Any, edge: int, wide: int, out: Any, upper: Any, work: Any) -> None:
        v, vs, a, p, v_turned, vs_turned = work[0], work[1], work[2], work[3], work[4], work[5]
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
                if upper.size > 0:
                    for j in range(b):
                        upper[here, i, j] = -a[i, j]
            for i in range(b):
                for j in range(wide):
                    t = 0.0
                    for h in range(b):
                        t += v[i, h] * v_turned[h, j] + a[i, h] * vs_turned[h, j]
                    p[i, j] = t
                for j in range(b):
                    out[here, i, j] = p[i, j]

    return compile_kernel(run, "f3 n n f3 f3 f3")
