"""Block-tridiagonal algebra against dense algebra."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from estimator.numerics import BlockTridiagonal, eliminate


def chain(n: int, b: int, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Dense matrix, diagonal and lower blocks of a random positive definite chain; unknowns differ by `scale`."""
    rng = default_rng(n)
    full = np.eye(n * b)
    for k in range(n - 1):
        j = rng.normal(size=(b + 2, 2 * b))
        full[k * b:(k + 2) * b, k * b:(k + 2) * b] += j.T @ j
    units = np.tile(scale ** np.linspace(-1.0, 1.0, b), n)
    full *= units[:, None] * units
    blocks = full.reshape(n, b, n, b)
    return full, np.array([blocks[k, :, k] for k in range(n)]), \
        np.array([blocks[k + 1, :, k] for k in range(n - 1)]).reshape(n - 1, b, b)


WEIGHTS = np.array([1.0, 0.5, -2.0, 0.0])


@pytest.mark.parametrize("n, b", [(1, 3), (2, 3), (3, 6), (101, 3), (80, 6), (40, 9)])
def test_solution_and_inverse_agree_with_the_dense_ones(n: int, b: int) -> None:
    full, diagonal, lower = chain(n, b)
    dense, rhs = np.linalg.inv(full), default_rng(1).normal(size=(n * b, 4))
    swept = eliminate(BlockTridiagonal.of(diagonal, lower, rhs))
    assert_allclose(swept.product(), rhs.T @ dense @ rhs, atol=1e-10)
    assert_allclose(swept.solution(WEIGHTS), (dense @ rhs @ WEIGHTS).reshape(n, b), atol=1e-11)
    assert_allclose(swept.solutions(), (dense @ rhs).reshape(n, b, 4), atol=1e-11)
    assert swept.log_determinant() == pytest.approx(np.linalg.slogdet(full)[1], rel=1e-12)
    blocks = dense.reshape(n, b, n, b)
    assert_allclose(swept.inverse_diagonal(), [blocks[k, :, k] for k in range(n)], atol=1e-12)
    diagonal, upper = swept.inverse_blocks()
    assert_array_equal(diagonal, swept.inverse_diagonal())
    known = np.array([blocks[k, :, k + 1] for k in range(n - 1)]).reshape(n - 1, b, b)
    assert_allclose(upper, known, atol=1e-12)


def test_a_long_chain_of_short_ones_has_their_solutions() -> None:
    times, (_, diagonal, lower) = 300, chain(20, 6)
    rhs = default_rng(2).normal(size=(20 * 6, 4))
    short = eliminate(BlockTridiagonal.of(diagonal, lower, rhs))
    open_ends = np.concatenate([lower, np.zeros((1, 6, 6))])
    long = eliminate(BlockTridiagonal.of(np.tile(diagonal, (times, 1, 1)), np.tile(open_ends, (times, 1, 1))[:-1],
                                         np.tile(rhs, (times, 1))))
    assert_allclose(long.product(), times * short.product(), rtol=1e-10)
    assert_allclose(long.solution(WEIGHTS), np.tile(short.solution(WEIGHTS), (times, 1)), atol=1e-12)
    assert_allclose(long.inverse_diagonal(), np.tile(short.inverse_diagonal(), (times, 1, 1)), atol=1e-12)


def test_units_far_apart_cost_no_digits() -> None:
    full, diagonal, lower = chain(60, 3, scale=1e6)
    units = np.sqrt(np.diag(full))
    dense = np.linalg.inv(full / np.outer(units, units))
    swept = eliminate(BlockTridiagonal.of(diagonal, lower, np.zeros((180, 1))))
    found = swept.inverse_diagonal() * units.reshape(60, 3)[:, :, None] * units.reshape(60, 3)[:, None]
    blocks = dense.reshape(60, 3, 60, 3)
    assert_allclose(found, [blocks[k, :, k] for k in range(60)], atol=1e-11)


@pytest.mark.parametrize("n", [5, 80])
def test_a_matrix_that_is_not_positive_definite_is_refused(n: int) -> None:
    _, diagonal, lower = chain(n, 3)
    diagonal[n // 2] -= 100.0 * np.eye(3)
    with pytest.raises(np.linalg.LinAlgError):
        eliminate(BlockTridiagonal.of(diagonal, lower, np.zeros((3 * n, 1))))
