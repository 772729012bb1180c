"""Block-tridiagonal systems eliminated at linear cost, and what is compiled by Numba, inverses of singular matrices."""

from estimator.numerics import banded_cholesky, jit
from estimator.numerics.block_tridiagonal import BlockTridiagonal, padded
from estimator.numerics.cyclic_reduction import gram
from estimator.numerics.elimination import eliminate
from estimator.numerics.jit import at, compiled
from estimator.numerics.pseudo_inverse import pseudo_inverse

__all__ = ["BlockTridiagonal", "at", "banded_cholesky", "compiled", "eliminate", "gram", "jit", "padded",
           "pseudo_inverse"]
