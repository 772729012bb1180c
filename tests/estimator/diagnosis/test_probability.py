"""The probability of an answer: weights of rival sets, and how often resampled runs give the same verdict."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from estimator.diagnosis.context import Explanation
from estimator.diagnosis.decision_rule import MATERIAL, SURE
from estimator.diagnosis.error_table import ErrorTable
from estimator.diagnosis.model_comparison import LEAST_APART
from estimator.diagnosis.probability import probability_of, probability_of_no_error
from estimator.diagnosis.verdict import Decision, passed

BLOCKS = 40


def explained(gain: float, *effects: str, told_by: int | None = None, significant: bool = True) -> Explanation:
    """With effects of one size; `told_by` the size that sets them apart from others that act as a constant torque."""
    group = "" if told_by is None and effects != ("offset",) else "constant"
    model: Any = SimpleNamespace(
        effects=tuple(SimpleNamespace(key=key, sizes=(0,), equivalence_class=group, distinguishing_size=told_by)
                      for key in effects),
        places=lambda: [slice(k, k + 1) for k in range(len(effects))], std=lambda: np.ones(len(effects)),
        sizes=lambda: [np.array([9.0 if significant else 1.0]) for _ in effects])
    left: Any = SimpleNamespace(scatter=1.0)
    return Explanation(model, gain, left, inflation=np.ones(len(effects)), determined=np.ones(len(effects), dtype=bool))


def table_of(*errors: float, spread: float = 0.25) -> ErrorTable:
    """Models whose rms errors are `errors`, with the same scatter from block to block in all of them."""
    common = np.random.default_rng(4).gamma(1.0 / spread**2, spread**2, (1, BLOCKS, 2))
    common /= common.mean()
    values = np.array(errors)[:, None, None] ** 2 * common
    agreement = np.array([[10.0 * k] * 2 for k in range(len(errors))])
    return ErrorTable((("q1_rad", 1.0), ("q2_rad", 1.0)), values, agreement, np.repeat([0, 1], BLOCKS // 2), (),
                      cast(Any, None))


def asked(table: ErrorTable, *sets: Explanation, stated: int = 1) -> Decision:
    """The first `stated` of `sets` are the best; their rows follow the nominal model's."""
    return Decision("named", sets[:stated], table, 1, (), 1, 0, None, table.draws(np.random.default_rng(1)),
                    possible=tuple((e, k) for k, e in enumerate(sets, 1)))


def test_a_clear_answer_is_nearly_certain() -> None:
    found = passed(asked(table_of(9.0, 1.2, 8.0), explained(900.0, "drag"), explained(899.0, "spring")), None, MATERIAL)
    assert found.verdict == "named" and probability_of(found, MATERIAL) == pytest.approx(1.0)


@pytest.mark.parametrize(("behind", "stated", "expected"), [
    (0.0, 1, 0.5), (0.0, 2, 1.0), (LEAST_APART, 1, SURE), (400.0, 1, 1.0)])
def test_rivals_that_fit_alike_share_the_probability(behind: float, stated: int, expected: float) -> None:
    """A rival of as many effects and about the same error counts by its likelihood, tempered; larger sets do not."""
    sets = explained(900.0, "drag"), explained(900.0 - behind, "spring"), explained(2000.0, "drag", "spring")
    found = passed(asked(table_of(9.0, 1.2, 1.2, 1.15), *sets, stated=stated), None, MATERIAL)
    assert probability_of(found, MATERIAL) == pytest.approx(expected, abs=1e-3)


def test_what_rivals_leave_makes_the_likelihood_less_sure() -> None:
    """A further effect brings a rival, 400 behind, to the limit of a tie; further likelihood then counts for less."""
    left = [replace(explained(900.0, "drag"), further=np.array([500.0])),
            replace(explained(500.0, "spring"), further=np.array([900.0 - LEAST_APART]))]
    found = passed(asked(table_of(9.0, 1.2, 1.2), *left), None, MATERIAL)
    assert probability_of(found, MATERIAL) == pytest.approx(SURE, abs=1e-3)


@pytest.mark.parametrize("rival", [199_000.0, 190_000.0])
def test_a_likelier_set_that_simulates_worse_is_no_rival(rival: float) -> None:
    """Its weight is that of the others by far: they are weighed among themselves."""
    sets = [explained(gain, key) for gain, key in ((100_000.0, "ripple"), (99_900.0, "delay"), (rival, "tilt"))]
    found = passed(asked(table_of(37.8, 1.0, 1.0, 9.0), *sets), None, MATERIAL)
    assert probability_of(found, MATERIAL) == pytest.approx(1.0)


@pytest.mark.parametrize(("significant", "expected"), [(False, 1.0), (True, 0.5)])
def test_a_spring_without_stiffness_is_no_rival_of_an_offset(significant: bool, expected: float) -> None:
    sets = explained(900.0, "offset"), explained(900.0, "spring", told_by=0, significant=significant)
    found = passed(asked(table_of(9.0, 1.2, 1.2), *sets), None, MATERIAL)
    assert probability_of(found, MATERIAL) == pytest.approx(expected, abs=1e-3)


def test_nothing_material_is_uncertain_where_a_set_is_nearly_material() -> None:
    """A ripple took a tenth of a saturated motor's error of 1.35 floors."""
    chances = []
    for after in (1.3, 1.215):
        table = table_of(1.35, 1.34, after)
        scatter = np.random.default_rng(5).normal(size=(BLOCKS, 1))
        table.values[2] *= 1.0 + 0.1 * (scatter - scatter.mean())
        found = passed(asked(table, explained(900.0, "drag"), explained(800.0, "ripple")), None, MATERIAL)
        assert found.verdict == "none"
        chances.append(probability_of(found, MATERIAL))
    assert chances[0] == 1.0 and chances[1] is not None and 0.1 < chances[1] < 0.9


def test_a_verdict_near_its_threshold_is_uncertain() -> None:
    drag = explained(900.0, "drag")
    chances = {}
    for before in (1.2, 1.49):
        found = passed(asked(table_of(before, before), drag), None, MATERIAL)
        chances[before] = probability_of(found, MATERIAL)
    assert found.verdict == "none" and chances[1.2] == 1.0
    assert chances[1.49] is not None and 0.4 < chances[1.49] < 0.8
    part = passed(asked(table_of(9.0, 2.0), drag), None, MATERIAL)
    assert part.verdict == "partial" and probability_of(part, MATERIAL) == pytest.approx(1.0)  # the cause is present
    near = passed(asked(table_of(9.0, 1.89), drag), None, MATERIAL)
    chance = probability_of(near, MATERIAL)
    assert near.verdict == "named" and chance is not None and chance < 0.95  # it could leave something


def test_an_answer_without_a_cause_has_no_probability() -> None:
    found = passed(asked(table_of(12.1, 9.4), explained(900.0, "spring")), None, MATERIAL)
    assert found.verdict == "unexplained" and probability_of(found, MATERIAL) is None


def test_rivals_are_those_of_the_held_out_runs_where_the_split_rotated() -> None:
    first = asked(table_of(9.0, 1.2, 1.2), explained(900.0, "drag"), explained(900.0, "spring"))
    turned = replace(first, table=table_of(9.0, 1.2), unturned=first)
    assert probability_of(passed(turned, None, MATERIAL), MATERIAL) == pytest.approx(0.5, abs=1e-3)


def test_no_error_is_as_probable_as_it_stays_within_the_noise() -> None:
    rng = np.random.default_rng(2)
    assert probability_of_no_error(table_of(1.05), rng) == 1.0
    assert 0.2 < probability_of_no_error(table_of(1.5), rng) < 0.8
