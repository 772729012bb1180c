"""The structure of runs that has no name."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.change.scores import RunScore
from estimator.change.structure import _misfit, _rows


def test_a_variance_far_beyond_the_others_is_less_likely_and_one_beyond_all_numbers_least() -> None:
    """A search that came there ended in a traceback: the covariance is singular."""
    rng = np.random.default_rng(0)
    draws = [rng.normal(size=(6, 6)) for _ in range(4)]
    rows = _rows([RunScore(rng.normal(size=6), draw @ draw.T) for draw in draws], np.ones(6), 2)
    assert _misfit(np.zeros(2), [rows]) < _misfit(np.array([90.0, -90.0]), [rows]) < np.inf
    assert _misfit(np.array([800.0, 0.0]), [rows]) == np.inf


def test_the_misfit_is_that_of_the_whole_covariance() -> None:
    rng = np.random.default_rng(1)
    draws = [rng.normal(size=(6, 6)) for _ in range(4)]
    rows = _rows([RunScore(rng.normal(size=6), draw @ draw.T) for draw in draws], np.ones(6), 2)
    for logs in np.array([[0.0, 0.0], [1.0, -2.0], [-3.0, 2.0]]):
        common, own = np.exp(logs)
        covariance = np.eye(rows.y.size) + common * rows.common @ rows.common.T + own * np.diag(rows.own)
        inverse = np.linalg.inv(covariance)
        told = rows.free.T @ inverse @ rows.free
        left = rows.y - rows.free @ np.linalg.solve(told, rows.free.T @ inverse @ rows.y)
        whole = 0.5 * (np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(told)[1] + left @ inverse @ left)
        assert _misfit(logs, [rows]) == pytest.approx(whole - 0.5 * logs.sum(), rel=1e-9)
