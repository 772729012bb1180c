"""Block-tridiagonal systems eliminated at linear cost, and what is compiled by Numba, inverses of singular matrices."""

from estimator.numerics import jit
from estimator.numerics.block_cholesky_numba import Swept, eliminate
from estimator.numerics.block_tridiagonal import BlockTridiagonal, padded
from estimator.numerics.jit import Kernel, at
from estimator.numerics.pseudo_inverse import pseudo_inverse

__all__ = ["BlockTridiagonal", "Kernel", "Swept", "at", "eliminate", "jit", "padded", "pseudo_inverse"]
