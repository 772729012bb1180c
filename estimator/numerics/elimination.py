"""`eliminate`: the latents out of the normal equations, by the compiled sweep or in odd-even order by arrays."""

from __future__ import annotations

from estimator.numerics import block_cholesky_numba, cyclic_reduction, jit
from estimator.numerics.block_tridiagonal import BlockTridiagonal


def eliminate(chain: BlockTridiagonal) -> block_cholesky_numba.Swept | cyclic_reduction.Eliminated:
    """Factor `chain` and go forward through its right sides; it is used up.

    Raises numpy.linalg.LinAlgError where its matrix is not positive definite.
    """
    return (block_cholesky_numba if jit.ready() else cyclic_reduction).eliminate(chain)
