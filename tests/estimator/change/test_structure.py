"""The structure of runs that has no name."""

from __future__ import annotations

import numpy as np

from estimator.change.scores import RunScore
from estimator.change.structure import _misfit, _rows


def test_a_variance_that_makes_the_covariance_singular_is_the_least_likely() -> None:
    """A search that came there ended in a traceback."""
    rng = np.random.default_rng(0)
    draws = [rng.normal(size=(6, 6)) for _ in range(4)]
    rows = _rows([RunScore(rng.normal(size=6), draw @ draw.T) for draw in draws], np.ones(6), 2)
    assert np.isfinite(_misfit(np.zeros(2), [rows]))
    assert _misfit(np.array([90.0, -90.0]), [rows]) == np.inf
