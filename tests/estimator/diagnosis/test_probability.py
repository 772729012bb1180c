"""The probability of an answer: weights of rival sets, and how often resampled runs give the same verdict."""

from dataclasses import replace

import numpy as np
from pytest import approx, mark

from estimator.diagnosis import MATERIAL
from estimator.diagnosis.decision_rule import SURE
from estimator.diagnosis.error_table import ErrorTable
from estimator.diagnosis.explanation import LEAST_APART, Explanation
from estimator.diagnosis.verdict import Family, decide, probability_of
from tests.support.stated_fits import Named, explained
from tests.support.stated_tables import family_of, table_of

BLOCKS = 40


def table(*errors: float) -> ErrorTable:
    return table_of(*errors, spread=0.25, blocks=BLOCKS)


def chance(found: ErrorTable, family: Family, verdict: str, first: ErrorTable | None = None) -> float | None:
    """Of what is decided, which is this `verdict`."""
    decision = decide(found, family, MATERIAL)
    assert decision.verdict == verdict
    return probability_of(decision, found, family, found if first is None else first, MATERIAL)


def against(*sets: Explanation, stated: int = 1) -> Family:
    """The first `stated` of `sets` are the answer, all others their rivals, in rows that follow the nominal model's."""
    return replace(family_of(*sets[:stated]), rivals=tuple((e, k) for k, e in enumerate(sets[1:], 2)))


def test_a_clear_answer_is_nearly_certain() -> None:
    family = against(explained(900.0, "drag"), explained(899.0, "spring"))
    assert chance(table(9.0, 1.2, 8.0), family, "named") == approx(1.0)


@mark.parametrize(("behind", "stated", "expected"), [
    (0.0, 1, 0.5), (0.0, 2, 1.0), (LEAST_APART, 1, SURE), (400.0, 1, 1.0)])
def test_rivals_that_fit_alike_share_the_probability(behind: float, stated: int, expected: float) -> None:
    """A rival of as many effects and about the same error counts by its likelihood, tempered; larger sets do not."""
    family = against(explained(900.0, "drag"), explained(900.0 - behind, "spring"),
                     explained(2000.0, "drag", "spring"), stated=stated)
    assert chance(table(9.0, 1.2, 1.2, 1.15), family, "named") == approx(expected, abs=1e-3)


def test_what_rivals_leave_makes_the_likelihood_less_sure() -> None:
    """A further effect brings a rival, 400 behind, to the limit of a tie; further likelihood then counts for less."""
    family = against(explained(900.0, "drag", further=[500.0]),
                     explained(500.0, "spring", further=[900.0 - LEAST_APART]))
    assert chance(table(9.0, 1.2, 1.2), family, "named") == approx(SURE, abs=1e-3)


@mark.parametrize("rival", [199_000.0, 190_000.0])
def test_a_likelier_set_that_simulates_worse_is_no_rival(rival: float) -> None:
    """Its weight is that of the others by far: they are weighed among themselves."""
    family = against(explained(100_000.0, "ripple"), explained(99_900.0, "delay"), explained(rival, "tilt"))
    assert chance(table(37.8, 1.0, 1.0, 9.0), family, "named") == approx(1.0)


@mark.parametrize(("size", "expected"), [(1.0, 1.0), (9.0, 0.5)])
def test_a_spring_without_stiffness_is_no_rival_of_an_offset(size: float, expected: float) -> None:
    spring = Named("spring", equivalence_class="constant", distinguishing_size=0)
    family = against(explained(900.0, Named("offset", equivalence_class="constant")),
                     explained(900.0, spring, size=size))
    assert chance(table(9.0, 1.2, 1.2), family, "named") == approx(expected, abs=1e-3)


def test_nothing_material_is_uncertain_where_a_set_is_nearly_material() -> None:
    """A ripple took a tenth of a saturated motor's error of 1.35 floors."""
    chances = []
    for after in (1.3, 1.215):
        found = table(1.35, 1.34, after)
        scatter = np.random.default_rng(5).normal(size=(BLOCKS, 1))
        found.values[2] *= 1.0 + 0.1 * (scatter - scatter.mean())
        chances.append(chance(found, against(explained(900.0, "drag"), explained(800.0, "ripple")), "none"))
    assert chances[0] == 1.0 and chances[1] is not None and 0.1 < chances[1] < 0.9


def test_a_verdict_near_its_threshold_is_uncertain() -> None:
    family = family_of()
    assert chance(table(1.2, 1.2), family, "none") == 1.0
    edge = chance(table(1.49, 1.49), family, "none")
    assert edge is not None and 0.4 < edge < 0.8
    assert chance(table(9.0, 2.0), family, "partial") == approx(1.0)  # the cause is present
    near = chance(table(9.0, 1.89), family, "named")
    assert near is not None and near < 0.95  # it could leave something


def test_a_refused_name_and_an_unexplained_error_have_no_probability() -> None:
    assert chance(table(12.1, 9.4), family_of(), "unexplained") is None
    assert chance(table(1.9, 1.9), family_of(), "unexplained") is None
    assert chance(table(1.45, 1.05), family_of(imitates=True), "none") is None


def test_rivals_are_those_of_the_first_test_runs_where_the_split_rotated() -> None:
    family = against(explained(900.0, "drag"), explained(900.0, "spring"))
    turned = table(9.0, 1.2, np.nan)  # a rival is not fitted again
    assert chance(turned, family, "named", table(9.0, 1.2, 1.2)) == approx(0.5, abs=1e-3)


def test_no_error_is_as_probable_as_it_stays_within_the_noise() -> None:
    assert chance(table(1.05), Family(0), "none") == 1.0
    edge = chance(table(1.5), Family(0), "none")
    assert edge is not None and 0.2 < edge < 0.8


def test_no_fault_but_what_tolerances_hold_is_as_probable_as_its_name() -> None:
    """It reduces the error, as it must: that is no reason against it."""
    offset = replace(explained(900.0, "offset"), within=frozenset({"offset"}))
    family = against(offset, explained(600.0, "spring"))
    assert chance(table(9.0, 1.1, 8.0), family, "none") == approx(1.0)
