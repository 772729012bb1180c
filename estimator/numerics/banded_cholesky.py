"""Symmetric block-tridiagonal systems by LAPACK's banded Cholesky: the quickest where only solutions are wanted.

Where the inverse's diagonal is wanted too, or the chain is long, see `estimator.numerics.cyclic_reduction`.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from daq import FloatArray


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
