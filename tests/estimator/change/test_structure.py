"""The structure of runs that has no name."""

import numpy as np
from numpy.random import Generator, default_rng
from pytest import approx, mark

from estimator.change.structure import _restricted, _rows, _Run, _Variances, find_structure
from estimator.score import Score


def known_runs() -> list[_Run]:
    rng = default_rng(1)
    draws = [rng.normal(size=(6, 6)) for _ in range(4)]
    return _rows([Score(rng.normal(size=6), draw @ draw.T) for draw in draws], np.ones(6))


@mark.parametrize("at", [_Variances(1.0, 1.0, np.zeros(0), ()), _Variances(2.7, 0.1, np.array([3.0]), (4,)),
                                _Variances(0.05, 7.0, np.array([5.0, 0.2]), (0, 3))])
def test_the_misfit_is_that_of_the_whole_covariance(at: _Variances) -> None:
    runs = known_runs()
    columns, y = np.concatenate([run.columns for run in runs]), np.concatenate([run.y for run in runs])
    spread = np.full(6, at.own)
    spread[list(at.where)] += at.drift
    covariance = np.eye(y.size) + at.common * columns[:, 2:] @ columns[:, 2:].T
    edges = np.cumsum([0, *(len(run.y) for run in runs)])
    for run, begin, end in zip(runs, edges, edges[1:]):
        covariance[begin:end, begin:end] += run.columns * spread @ run.columns.T
    inverse, free = np.linalg.inv(covariance), columns[:, :2]
    told = free.T @ inverse @ free
    left = y - free @ np.linalg.solve(told, free.T @ inverse @ y)
    whole = 0.5 * (np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(told)[1] + left @ inverse @ left)
    assert _restricted(runs, 2, at).misfit == approx(whole, rel=1e-9)


def test_slopes_are_those_of_the_misfit() -> None:
    runs, step = known_runs(), 1e-5
    at = _Variances(0.5, 0.3, np.array([2.0, 0.7]), (0, 4))
    found = _restricted(runs, 2, at)

    def slope(more: _Variances, less: _Variances) -> float:
        return (_restricted(runs, 2, more).misfit - _restricted(runs, 2, less).misfit) / (2.0 * step)

    common = slope(at._replace(common=0.5 + step), at._replace(common=0.5 - step))
    assert found.common == approx(common, rel=1e-5)
    own = slope(at._replace(own=0.3 + step), at._replace(own=0.3 - step))
    assert found.columns.sum() == approx(own, rel=1e-5)
    for k, column in enumerate(at.where):
        moved = [at._replace(drift=at.drift + sign * step * np.eye(2)[k]) for sign in (1.0, -1.0)]
        assert found.columns[column] == approx(slope(*moved), rel=1e-5)


def session(rng: Generator, spread: np.ndarray, runs: int = 8) -> list[Score]:
    """Runs of 400 rows of a regression whose coefficients differ from run to run by `spread`."""
    found = []
    for _ in range(runs):
        rows = rng.normal(size=(400, spread.size)) + 0.5 * rng.normal(size=(400, 1))
        theta = spread * rng.normal(size=spread.size)
        found.append(Score(rows.T @ (rows @ theta + rng.normal(size=400)), rows.T @ rows))
    return found


def test_a_column_that_drifts_takes_its_variance_and_leaves_the_others_theirs() -> None:
    """True standard deviations: 0.5 of column 6, none of the others; a run tells 0.045 of a column."""
    rng, hits = default_rng(3), 0
    spread = np.zeros(30)
    spread[6] = 0.5
    for _ in range(10):
        found = find_structure([session(rng, spread)], 3)
        assert found.own < 0.5  # one variance for all columns is 4
        hits += set(np.flatnonzero(found.drift)) == {6}
        assert 0.2 < (found.scatter[6] ** 0.5) < 1.0
    assert hits >= 9


def test_no_column_drifts_where_none_differs_from_the_others() -> None:
    rng = default_rng(4)
    found = [find_structure([session(rng, np.full(30, spread))], 3) for spread in (0.0, 0.1) for _ in range(10)]
    assert sum(one.drift.any() for one in found) <= 1
