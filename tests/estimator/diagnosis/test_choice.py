"""Which of the fitted sets is the answer, by their errors and likelihoods: `is_material`, `choose`, `likeliest`."""

import numpy as np
from pytest import mark

from estimator.diagnosis import MATERIAL
from estimator.diagnosis.decision_rule import WIDTH
from estimator.diagnosis.explanation import Explanation, by_error, seated, shortlisted
from estimator.diagnosis.search import possible
from estimator.diagnosis.verdict import UNCHANGED, UNSURE, choose, is_material, is_open, likeliest, shortfall
from tests.support.stated_fits import AT_LIMIT, explained
from tests.support.stated_tables import BLOCKS, RUNS, scaled, table_of


def names(found: list[Explanation]) -> list[str]:
    return [" ".join(sorted(e.keys)) for e in found]


@mark.parametrize("errors, agreement, material", [
    ((3.0, 1.2), [[0, 0], [900, 800]], True),
    ((3.0, 2.9), [[0, 0], [900, 800]], False),  # beyond doubt by the likelihood, and of no consequence
    ((3.0, 1.2), [[0, 0], [900, -20]], True),  # a law of another form; the error of both runs falls
    ((3.0, 1.2), [[0, 0], [20, -900]], False),  # the runs together are less likely with it
    ((3.0, 3.4), [[0, 0], [900, 800]], False),  # it makes the free run worse
    ((1.02, 1.0), [[0, 0], [40, 50]], False)])
def test_a_cause_is_material_where_the_error_falls_and_the_runs_are_likelier(
        errors: tuple[float, ...], agreement: list[list[float]], material: bool) -> None:
    table = table_of(*errors, agreement=agreement)
    assert is_material(table, 1, 0, MATERIAL) is material and not is_material(table, 1, 1, MATERIAL)


def test_one_free_run_that_diverges_does_not_hide_a_lower_error_everywhere() -> None:
    """A wrong gyro scale took the error from 23.5 to 0.8. One piece of 20 made most of it, and a third of all
    resamplings do not hold that piece: the fall was not thought sure."""
    table = scaled(table_of(2.0, 0.8, agreement=[[0, 0], [900, 300]]), 0, 52.0, 9)
    assert np.mean([table.error(0, d) - table.error(1, d) > MATERIAL * table.error(0) for d in table.draws]) < 0.8
    assert is_material(table, 1, 0, MATERIAL)


def test_a_fall_in_most_resamplings_that_is_small_in_all_is_not_material() -> None:
    """Of the prismatic axis' error, 53 to 3.6 by its friction, one piece makes the most; terms without a name take 2.7
    more, a tenth of what the other pieces alone would err."""
    table = scaled(table_of(12.0, 3.6, 0.9), 0, 30.0, 9)
    assert table.error(0) > 50.0 and table.lowers(2, 1, MATERIAL, 0) > 0.3
    assert not is_material(table, 2, 1, MATERIAL, 0) and is_material(table, 1, 0, MATERIAL)


def test_a_run_that_errs_more_with_a_cause_speaks_against_it() -> None:
    table = table_of(3.0, 1.2, agreement=[[0, 0], [900, 300]])
    assert not table.raises(1, 0, MATERIAL, 0) and is_material(table, 1, 0, MATERIAL)
    worse = scaled(table, 1, 1.14 * 3.0 / 1.2, slice(BLOCKS // RUNS, None))
    assert worse.raises(1, 0, MATERIAL, 0) and not is_material(worse, 1, 0, MATERIAL)


def test_it_is_inconclusive_whether_an_error_falls_where_one_run_diverges() -> None:
    table = table_of(1.5, 1.0, agreement=[[0, 0], [900, 300]])
    diverging = scaled(table, 1, 8.0, 9)
    assert is_material(table, 1, 0, MATERIAL) and not is_material(diverging, 1, 0, MATERIAL)
    assert diverging.error(1) > diverging.error(0) and is_open(diverging, 1, 0, MATERIAL)
    assert not is_open(table_of(1.5, 1.48), 1, 0, MATERIAL)  # surely not material
    assert not is_open(table_of(1.5, 1.2, agreement=[[0, 0], [20, -90]]), 1, 0, MATERIAL)


def test_an_error_that_falls_but_not_for_sure_is_not_said_to_stay() -> None:
    for after, words in ((0.8, UNSURE), (23.0, UNCHANGED)):
        assert shortfall(table_of(23.5, after, agreement=[[0, 0], [20, -900]]), 1, MATERIAL) == words


@mark.parametrize(("swing", "told"), [(0.0, "presliding"), (0.35, "delay")])
def test_a_likelier_cause_is_left_out_only_where_it_surely_simulates_worse(swing: float, told: str) -> None:
    """A late motor of a geared leg, 1.28 to 1.15 floors, was called presliding friction, 1.28 to 1.0, that was e^116
    times less likely."""
    table = table_of(1.28, 1.15, 1.0, agreement=[[0, 0], [1000, 900], [900, 800]])
    table.values[1, : BLOCKS // 2] *= 1.0 - swing
    table.values[2, : BLOCKS // 2] *= 1.0 + swing
    among = [(explained(2010.0, "delay"), 1), (explained(1778.0, "presliding"), 2)]
    for best, row in (choose(among, table, MATERIAL), likeliest(among, table, MATERIAL, 0)):
        assert names(best) == [told] and row == (1 if told == "delay" else 2)


def test_sets_that_the_runs_do_not_tell_apart_are_chosen_together() -> None:
    among = [(explained(900.0, "drag"), 1), (explained(899.0, "spring"), 2), (explained(700.0, "play"), 3)]
    best, row = likeliest(among, table_of(9.0, 1.2, 1.2, 1.2), MATERIAL, 0)
    assert names(best) == ["drag", "spring"] and row == 1


@mark.parametrize(("errors", "agreement", "told"), [
    ((7.1, 1.62, 1.47), None, 1),  # a second law takes up a difference of form
    ((5.0, 3.0, 1.1), None, 2), ((6.9, 3.7, 1.4), None, 2),
    ((69.0, 3.7, 1.4), None, 2),  # it counts by what the first leaves, however large the error was
    ((6.9, 3.7, 1.4), [[0, 0], [900, 900], [700, 800]], 1)])  # less likely with it
def test_a_larger_set_is_chosen_where_it_lowers_what_the_smaller_leaves(
        errors: tuple[float, ...], agreement: list[list[float]] | None, told: int) -> None:
    """A wrong gyro scale together with an encoder's offset: 6.9, 3.7 by the offset alone, 1.4 by both."""
    among = [(explained(10_000.0, "offset"), 1), (explained(13_000.0, "offset", "scale"), 2)]
    best, row = choose(among, table_of(*errors, agreement=agreement), MATERIAL)
    assert row == told and best[0] is among[told - 1][0] and len(best) == 1


def test_where_no_fall_is_significant_the_errors_decide_and_else_the_fewest_effects() -> None:
    single, pair = explained(10_000.0, "load"), explained(10_400.0, "load", "play")
    unlikely = [[0, 0], [-9, -9], [-5, -5]]
    for errors, told in (((3.0, 2.0, 1.2), pair), ((3.0, 1.5, 1.45), single), ((3.0, 2.95, 2.9), single)):
        best, _ = choose([(single, 1), (pair, 2)], table_of(*errors, agreement=unlikely), MATERIAL)
        assert best == [single] if told is single else best == [pair]


def test_the_last_place_is_for_what_simulates_best() -> None:
    """A geared leg's IMU, 3 mrad askew: gain 5,482, and friction that moves the leg: gain 972."""
    every = (5482.0, "askew", 0.993), (5400.0, "biased", 0.993), (4000.0, "stiff", 1.002), (972.0, "stribeck", 0.927)
    found = [explained(gain, name, error=error) for gain, name, error in every]
    bristles = explained(1469.0, "bristles", error=0.5, size=AT_LIMIT)  # at a limit it is another thing
    askew, biased, _, stribeck = found
    assert seated([*found, bristles], 2) == [askew, stribeck]
    assert seated([askew, stribeck, biased], 2) == [askew, stribeck] and seated(found, 4) == found
    assert seated([bristles], 2) == [bristles] and seated([], 2) == []


def test_each_set_of_effects_is_listed_once_by_its_likeliest_fit() -> None:
    """Two fits of one set, from different starts, were rivals of each other: an internal error."""
    single, again, pair = explained(900.0, "a"), explained(950.0, "a"), explained(990.0, "b", "a")
    found = shortlisted([single, again, pair, explained(980.0, "a", "b")])
    assert len(found) == 2 and found[0] is again and found[1] is pair


def test_of_each_number_of_effects_the_likeliest_are_listed() -> None:
    singles = [explained(100.0 + k, f"e{k}") for k in range(12)]
    pairs = [explained(900.0 + k, f"e{k}", "f") for k in range(12)]
    found = shortlisted([*singles, *pairs])
    assert len(found) == 3 * WIDTH and sum(len(e.keys) == 1 for e in found) == WIDTH
    assert {id(e) for e in singles[-WIDTH + 1 :]} <= {id(e) for e in found}


def test_answers_stand_by_their_error_before_what_is_none() -> None:
    slight, good, none = (explained(900.0, "slight", error=0.9), explained(500.0, "good", error=0.4),
                          explained(990.0, "none", error=0.1, size=1.0))
    assert names(by_error([none, slight, good])) == ["good", "slight", "none"]
    assert names(possible([none, slight, good])) == ["slight", "good"] and names(possible([none])) == ["none"]
