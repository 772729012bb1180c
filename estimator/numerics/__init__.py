"""Block-tridiagonal and bidiagonal systems at linear cost, kernels compiled by Numba, pseudo-inverses, Student's t."""

from estimator.numerics.block_bidiagonal_numba import propagate, solve_bidiagonal
from estimator.numerics.block_cholesky_numba import Swept, eliminate
from estimator.numerics.block_tridiagonal import BlockTridiagonal, padded
from estimator.numerics.correlation import correlate
from estimator.numerics.kernel import at, compile_kernel, load_compiler
from estimator.numerics.pseudo_inverse import inverse_root, pseudo_inverse
from estimator.numerics.student_quantile import student_quantile

__all__ = ["BlockTridiagonal", "Swept", "at", "compile_kernel", "correlate", "eliminate", "inverse_root",
           "load_compiler", "padded", "propagate", "pseudo_inverse", "solve_bidiagonal", "student_quantile"]
