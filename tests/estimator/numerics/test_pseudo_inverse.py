"""One rule for information that a record may leave singular."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimator.numerics import inverse_root, pseudo_inverse


@pytest.fixture
def information() -> np.ndarray:
    """(3, 4, 4) well known in units that differ by a million."""
    a = np.random.default_rng(5).normal(size=(3, 12, 4)) * [1.0, 1e-3, 1e3, 1.0]
    return a.swapaxes(1, 2) @ a


def test_it_is_the_inverse_where_there_is_one(information: np.ndarray) -> None:
    known = np.linalg.inv(information)
    size = np.sqrt(np.einsum("rii->ri", known))
    both = size[:, :, None] * size[:, None, :]
    root = inverse_root(information)
    for found in (pseudo_inverse(information), root @ root.swapaxes(1, 2)):
        assert_allclose(found / both, known / both, atol=1e-11)


def test_damping_adds_to_the_diagonal(information: np.ndarray) -> None:
    damping = np.array([0.0, 0.3, 2.0])
    diagonal = np.einsum("rii->ri", information)[:, :, None] * np.eye(4)
    known = np.linalg.inv(information + damping[:, None, None] * diagonal)
    size = np.sqrt(np.einsum("rii->ri", known))
    assert_allclose((pseudo_inverse(information, damping) - known) / (size[:, :, None] * size[:, None, :]),
                               0.0, atol=1e-11)


def test_a_direction_that_nothing_shows_has_a_huge_variance_and_no_part_in_the_root() -> None:
    a = np.random.default_rng(6).normal(size=(9, 2))
    seen = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])  # the third is the first once more
    information = seen @ (a.T @ a) @ seen.T
    covariance, root = pseudo_inverse(information), inverse_root(information)
    both, apart = np.array([1.0, 0.0, 1.0]), np.array([1.0, 0.0, -1.0])
    assert apart @ covariance @ apart > 1e10
    assert both @ covariance @ both == pytest.approx(np.linalg.inv(a.T @ a)[0, 0], rel=0.01)  # their sum is seen
    assert np.abs(apart @ root).max() < 1e-6 * np.abs(both @ root).max()
