"""`solve_bidiagonal` against SciPy's banded solver."""

import numpy as np
import pytest
from scipy.linalg import solve_banded

from daq import FloatArray
from estimator.numerics import solve_bidiagonal


def banded(blocks: FloatArray, right: FloatArray) -> FloatArray:
    b, _, _, count = blocks.shape
    band = np.zeros((3 * b - 1, count * b))
    for i in range(b):
        for j in range(b):
            band[b - 1 + i - j, j::b] = blocks[i, 1, j]
            band[2 * b - 1 + i - j, j : (count - 1) * b : b] = blocks[i, 0, j, 1:]
    return np.asarray(solve_banded((2 * b - 1, b - 1), band, right.T.ravel())).reshape(count, b)


@pytest.mark.parametrize("b, count", [(2, 1), (4, 31), (4, 97), (6, 64)])
def test_the_system_is_solved_with_rows_exchanged_in_a_block(b: int, count: int) -> None:
    rng = np.random.default_rng(b)
    blocks = rng.normal(size=(b, 2, b, count))
    blocks[:, 0] *= 0.2
    blocks[0, 1, 0] = 0.0  # a pivot that is none
    right = rng.normal(size=(b, count))
    np.testing.assert_allclose(solve_bidiagonal(blocks, right), banded(blocks, right), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("bad", [0.0, np.nan])
def test_a_block_without_an_inverse_is_refused(bad: float) -> None:
    blocks, right = np.ones((2, 2, 2, 5)), np.ones((2, 5))
    blocks[0, 1], blocks[1, 1] = [[1.0] * 5, [0.0] * 5], [[0.0] * 5, [1.0] * 5]
    assert np.isfinite(solve_bidiagonal(blocks, right)).all()
    blocks[0, 1, :, 3] = bad
    with pytest.raises(np.linalg.LinAlgError, match="singular"), np.errstate(all="ignore"):
        solve_bidiagonal(blocks, right)
