"""Nuisances at their tolerances, integrated out; tolerances enlarged where the runs contradict them."""

import numpy as np
from numpy.random import Generator, default_rng
from pytest import approx

from daq import FloatArray
from estimator.score import Nuisance, Score, enlarged, marginalise, projected

P, K = 3, 6
FREE = np.ones(P, dtype=bool)
TOLERANCE = np.array([0.1, 0.2, 0.05, 0.3, 0.1, 0.2])


def information_of(seed: int) -> FloatArray:
    columns = default_rng(seed).normal(size=(400, P + K))
    columns[:, P] += columns[:, 0]  # a nuisance that looks like a parameter
    found: FloatArray = columns.T @ columns
    return found


def drawn(information: FloatArray, sizes: FloatArray, rng: Generator) -> Score:
    """The score of a record with these sizes (K,), parameters at zero."""
    truth = np.concatenate([np.zeros(P), sizes])
    return Score(information @ truth + np.linalg.cholesky(information) @ rng.normal(size=P + K), information)


def nuisances(tolerance: FloatArray) -> list[Nuisance]:
    return [Nuisance(f"n{k}", group, float(t)) for k, (group, t) in enumerate(zip("aabbcc", tolerance))]


def test_step_and_covariance_are_those_of_the_whole_normal_equations() -> None:
    information, rng = information_of(1), default_rng(2)
    score = drawn(information, TOLERANCE * rng.normal(size=K), rng)
    found = marginalise(projected(score, FREE), nuisances(TOLERANCE))
    prior = np.diag(np.concatenate([np.zeros(P), TOLERANCE**-2.0]))
    covariance = np.linalg.inv(information + prior)
    plain = np.linalg.inv(information[:P, :P])
    assert found.step + plain @ score.score[:P] == approx((covariance @ score.score)[:P])
    parts = found.noise + found.directions.T @ found.directions
    assert plain + parts == approx(covariance[:P, :P])
    by_tolerance = (covariance @ prior @ covariance)[:P, :P]
    assert found.directions.T @ found.directions == approx(by_tolerance)


def test_intervals_hold_what_they_say_where_sizes_are_drawn_from_the_tolerances() -> None:
    """Over many records; of a parameter that a nuisance looks like, far fewer do without."""
    information, rng = information_of(3), default_rng(4)
    plain = np.linalg.inv(information[:P, :P])
    held, held_plain = [], []
    for _ in range(500):
        score = drawn(information, TOLERANCE * rng.normal(size=K), rng)
        found = marginalise(projected(score, FREE), nuisances(TOLERANCE))
        start = plain @ score.score[:P]
        wide = plain + found.noise + found.directions.T @ found.directions
        held += list(np.abs(start + found.step) < 1.96 * np.sqrt(np.diag(wide)))
        held_plain.append(abs(start[0]) < 1.96 * np.sqrt(plain[0, 0]))
    assert np.mean(held) == approx(0.95, abs=0.02)
    assert np.mean(held_plain) < 0.6


def test_no_tolerance_changes_nothing() -> None:
    information, rng = information_of(5), default_rng(6)
    score = drawn(information, TOLERANCE, rng)
    found = marginalise(projected(score, FREE), nuisances(np.zeros(K)))
    assert not found.step.any() and not found.noise.any() and not found.directions.any()


def test_what_nothing_shows_adds_its_whole_tolerance() -> None:
    """A column that is a combination of the parameters moves them and is never learnt."""
    information = information_of(7)
    along = np.zeros(P + K + 1)
    basis = np.column_stack([np.eye(P + K), np.concatenate([[1.0, 2.0, 3.0], np.zeros(K)])])
    score = Score(np.zeros(P + K), information).along(basis)
    assert score.score.size == along.size
    found = marginalise(projected(score, FREE), [*nuisances(np.zeros(K)), Nuisance("gain", "gain", 0.05)])
    assert found.directions[-1] == approx([0.05, 0.1, 0.15]) and found.noise == approx(0.0, abs=1e-9)


def test_a_tolerance_that_is_too_small_is_enlarged_and_one_that_is_right_is_not() -> None:
    rng, grown = default_rng(8), {1.0: 0, 8.0: 0}
    for times in grown:
        for k in range(60):
            information = information_of(100 + k)
            real = TOLERANCE * np.where(np.arange(K) < 2, times, 1.0)
            found, factors = enlarged(projected(drawn(information, real * rng.normal(size=K), rng), FREE),
                                      nuisances(TOLERANCE))
            grown[times] += "a" in factors
            assert all(one.tolerance >= t for one, t in zip(found, TOLERANCE))
    assert grown[1.0] <= 3 and grown[8.0] >= 45
