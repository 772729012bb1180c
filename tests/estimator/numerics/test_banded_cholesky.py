"""Block-tridiagonal algebra against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.numerics import banded_cholesky, block_cholesky_numba, cyclic_reduction
from estimator.numerics.block_tridiagonal import BlockTridiagonal
from estimator.numerics.cyclic_reduction import DENSE, PIECE, factor, finish, halve, inverse_diagonal


def chain(n: int, b: int, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Dense matrix, diagonal and lower blocks of a random positive definite chain; unknowns differ by `scale`."""
    rng = np.random.default_rng(n)
    full = np.eye(n * b)
    for k in range(n - 1):
        j = rng.normal(size=(b + 2, 2 * b))
        full[k * b:(k + 2) * b, k * b:(k + 2) * b] += j.T @ j
    units = np.tile(scale ** np.linspace(-1.0, 1.0, b), n)
    full *= units[:, None] * units
    blocks = full.reshape(n, b, n, b)
    return full, np.array([blocks[k, :, k] for k in range(n)]), \
        np.array([blocks[k + 1, :, k] for k in range(n - 1)]).reshape(n - 1, b, b)


LENGTHS = [1, 2, 3, DENSE - 1, DENSE, DENSE + 1, 2 * DENSE, 2 * DENSE + 1, 2 * DENSE + 2, 101, 2 * PIECE + 7]


@pytest.mark.parametrize("n", LENGTHS)
def test_solution_and_inverse_agree_with_the_dense_ones(n: int) -> None:
    b = 3 if n < 200 else 1
    full, diagonal, lower = chain(n, b)
    factored, dense = factor(diagonal, lower), np.linalg.inv(full)
    rhs = np.random.default_rng(1).normal(size=(n * b, 4))
    banded = banded_cholesky.factor(diagonal, lower)
    np.testing.assert_allclose(banded_cholesky.solve(banded, rhs), dense @ rhs, atol=1e-11)
    np.testing.assert_allclose(banded_cholesky.solve(banded, rhs[:, 0]), dense @ rhs[:, 0], atol=1e-11)
    halves, weights = halve(factored, rhs), np.array([[1.0], [0.5], [-2.0], [0.0]])
    np.testing.assert_allclose(halves.product(), rhs.T @ dense @ rhs, atol=1e-10)
    np.testing.assert_allclose(finish(factored, halves.combine(weights)), dense @ rhs @ weights, atol=1e-11)
    blocks = dense.reshape(n, b, n, b)
    np.testing.assert_allclose(inverse_diagonal(factored), [blocks[k, :, k] for k in range(n)], atol=1e-12)


def test_units_far_apart_cost_no_digits() -> None:
    full, diagonal, lower = chain(60, 3, scale=1e6)
    units = np.sqrt(np.diag(full))
    dense = np.linalg.inv(full / np.outer(units, units))
    found = inverse_diagonal(factor(diagonal, lower)) * units.reshape(60, 3)[:, :, None] * units.reshape(60, 3)[:, None]
    blocks = dense.reshape(60, 3, 60, 3)
    np.testing.assert_allclose(found, [blocks[k, :, k] for k in range(60)], atol=1e-11)


@pytest.mark.parametrize("n", [5, 80])
def test_a_matrix_that_is_not_positive_definite_is_refused(n: int) -> None:
    _, diagonal, lower = chain(n, 3)
    diagonal[n // 2] -= 100.0 * np.eye(3)
    for by in (factor, banded_cholesky.factor):
        with pytest.raises(np.linalg.LinAlgError):
            by(diagonal, lower)


@pytest.mark.parametrize(("n", "b"), [(1, 6), (2, 6), (3, 6), (80, 6), (PIECE + 5, 6), (40, 3)])
def test_one_compiled_sweep_finds_what_odd_even_order_finds(n: int, b: int) -> None:
    pytest.importorskip("numba", reason="needs the extra `fast`")
    _, diagonal, lower = chain(n, b) if n < 200 else short_chains(n, b)
    rhs, weights = np.random.default_rng(2).normal(size=(n * b, 5)), np.array([1.0, 0.5, -2.0, 0.0, 3.0])
    swept, plain = (by.eliminate(BlockTridiagonal.of(diagonal, lower, rhs))
                    for by in (block_cholesky_numba, cyclic_reduction))
    for found, known in ((swept.product(), plain.product()), (swept.solution(weights), plain.solution(weights)),
                         (swept.inverse_diagonal(), plain.inverse_diagonal())):
        np.testing.assert_allclose(found, known, rtol=0.0, atol=1e-10 * np.abs(known).max())
    diagonal[n // 2] -= 100.0 * np.eye(b)
    with pytest.raises(np.linalg.LinAlgError):
        block_cholesky_numba.eliminate(BlockTridiagonal.of(diagonal, lower, rhs))


def short_chains(n: int, b: int) -> tuple[None, np.ndarray, np.ndarray]:
    """Blocks of a long chain that repeats a short one; no dense matrix of it."""
    _, diagonal, lower = chain(20, b)
    lower = np.concatenate([lower, np.zeros((1, b, b))])
    times = n // 20 + 1
    return None, np.tile(diagonal, (times, 1, 1))[:n].copy(), np.tile(lower, (times, 1, 1))[: n - 1].copy()
