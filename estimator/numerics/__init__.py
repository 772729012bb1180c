"""Block-tridiagonal and bidiagonal systems at linear cost, kernels compiled by Numba, pseudo-inverses."""

from estimator.numerics import jit
from estimator.numerics.block_bidiagonal_numba import propagate, solve_bidiagonal
from estimator.numerics.block_cholesky_numba import Swept, eliminate
from estimator.numerics.block_tridiagonal import BlockTridiagonal, padded
from estimator.numerics.jit import Kernel, at
from estimator.numerics.pseudo_inverse import inverse_root, pseudo_inverse

__all__ = ["BlockTridiagonal", "Kernel", "Swept", "at", "eliminate", "inverse_root", "jit", "padded", "propagate",
           "pseudo_inverse", "solve_bidiagonal"]
