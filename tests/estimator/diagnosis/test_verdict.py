"""The rule of a verdict: what matters is what changes the simulation's error on runs that chose nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from estimator.diagnosis import error_table, procedure, verdict
from estimator.diagnosis.context import DiagnosisContext, Explanation
from estimator.diagnosis.decision_rule import MATERIAL
from estimator.diagnosis.error_budget import budget
from estimator.diagnosis.error_table import ErrorTable, _bounded
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.verdict import (
    Decision,
    choose,
    is_material,
    is_open,
    judge,
    second_cause,
    shortfall,
    shortlisted,
    unnamed,
)
from estimator.errors import FitError
from estimator.score import NO_TESTS

BLOCKS, RUNS = 20, 2
NOTHING_LEFT = replace(NO_TESTS, inflation=np.ones(1))


def table_of(*errors: float, agreement: list[list[float]] | None = None, seed: int = 0) -> ErrorTable:
    """Models whose rms errors are `errors` in units of noise alone, scattered from block to block as real ones are."""
    common = np.random.default_rng(seed).gamma(4.0, 0.25, (1, BLOCKS, 3))
    common /= common.mean()
    values = np.array(errors)[:, None, None] ** 2 * common
    told = np.array(agreement if agreement is not None else [[10.0 * k] * RUNS for k in range(len(errors))])
    return ErrorTable((("q1_rad", 1.0), ("q2_rad", 1.0), ("q2_rad", np.inf)), values, told,
                      np.repeat(np.arange(RUNS), BLOCKS // RUNS), (), cast(Any, None))


@dataclass(frozen=True)
class Fitted:
    """As much of a model as the choice looks at."""

    effects: tuple[str, ...]

    def sizes(self) -> list[Any]:
        return []


def explained(gain: float, *effects: str) -> Explanation:
    return Explanation(cast(Any, Fitted(tuple(cast(Any, Named(e)) for e in effects))), gain, NOTHING_LEFT, False,
                       np.full(6, gain / 6))


@dataclass(frozen=True)
class Named:
    key: str
    equivalence_class: str = ""
    distinguishing_size: int | None = None


@pytest.mark.parametrize("errors, agreement, material", [
    ((3.0, 1.2), [[0, 0], [900, 800]], True),
    ((3.0, 2.9), [[0, 0], [900, 800]], False),  # beyond doubt by the likelihood, and of no consequence
    ((3.0, 1.2), [[0, 0], [900, -20]], True),  # a law of another form; the error of both runs falls
    ((3.0, 1.2), [[0, 0], [20, -900]], False),  # the runs together are less likely with it
    ((3.0, 3.4), [[0, 0], [900, 800]], False),  # it makes the free run worse
    ((1.02, 1.0), [[0, 0], [40, 50]], False)])
def test_a_cause_is_material_where_the_error_falls_and_the_runs_are_likelier(
        errors: tuple[float, ...], agreement: list[list[float]], material: bool) -> None:
    table = table_of(*errors, agreement=agreement)
    draws = table.draws(np.random.default_rng(1))
    assert is_material(table, 1, 0, MATERIAL, draws) is material


def test_one_free_run_that_diverges_does_not_hide_a_lower_error_everywhere() -> None:
    """A wrong gyro scale took the error from 23.5 to 0.8. One piece of 20 made most of it, and a third of all
    resamplings do not hold that piece: the fall was not thought sure."""
    table = table_of(2.0, 0.8, agreement=[[0, 0], [900, 300]])
    table.values[0, 9] *= 52.0**2
    draws = table.draws(np.random.default_rng(1))
    assert np.mean([table.error(0, d) - table.error(1, d) > MATERIAL * table.error(0) for d in draws]) < 0.8
    assert is_material(table, 1, 0, MATERIAL, draws)


def test_a_fall_in_most_resamplings_that_is_small_in_all_is_not_material() -> None:
    """Of the prismatic axis' error, 53 to 3.6 by its friction, one piece makes the most; terms without a name take 2.7
    more, a tenth of what the other pieces alone would err."""
    table = table_of(12.0, 3.6, 0.9)
    table.values[0, 9] *= 30.0**2
    draws = table.draws(np.random.default_rng(1))
    assert table.error(0) > 50.0 and table.lowers(2, 1, MATERIAL, draws, 0) > 0.3
    assert not is_material(table, 2, 1, MATERIAL, draws, 0) and is_material(table, 1, 0, MATERIAL, draws)


def test_a_run_that_errs_more_with_a_cause_speaks_against_it() -> None:
    table = table_of(3.0, 1.2, agreement=[[0, 0], [900, 300]])
    assert not table.raises(1, 0, MATERIAL, 0)
    table.values[1, BLOCKS // RUNS :] = table.values[0, BLOCKS // RUNS :] * 1.3
    assert table.raises(1, 0, MATERIAL, 0)
    assert not is_material(table, 1, 0, MATERIAL, table.draws(np.random.default_rng(1)))


def test_it_is_inconclusive_whether_an_error_falls_where_one_run_diverges() -> None:
    """Of a saturated motor's runs kept back one strayed with the cause and not without: 1.35 to 3.08, and all eight
    together 23.9 to 1.13."""
    table = table_of(1.5, 1.0, agreement=[[0, 0], [900, 300]])
    draws = table.draws(np.random.default_rng(1))
    assert is_material(table, 1, 0, MATERIAL, draws)
    table.values[1, 9] *= 8.0**2
    assert not is_material(table, 1, 0, MATERIAL, draws) and table.error(1) > table.error(0)
    assert is_open(table, 1, 0, MATERIAL, draws)
    small = table_of(1.5, 1.48, agreement=[[0, 0], [900, 300]])
    assert not is_open(small, 1, 0, MATERIAL, draws)  # surely not material
    assert not is_open(table_of(1.5, 1.2, agreement=[[0, 0], [20, -90]]), 1, 0, MATERIAL, draws)


@pytest.mark.parametrize(("swing", "told"), [(0.0, ["presliding"]), (0.35, ["delay"])])
def test_a_likelier_cause_is_left_out_only_where_it_surely_simulates_worse(swing: float, told: list[str]) -> None:
    """A late motor of a geared leg, 1.28 to 1.15 floors, was called presliding friction, 1.28 to 1.0, that was e^116
    times less likely."""
    table = table_of(1.28, 1.15, 1.0, agreement=[[0, 0], [1000, 900], [900, 800]])
    table.values[1, : BLOCKS // 2] *= 1.0 - swing
    table.values[2, : BLOCKS // 2] *= 1.0 + swing
    possible = [(replace(e, by_run=-e.by_run), k)
                for k, e in enumerate([explained(2010.0, "delay"), explained(1778.0, "presliding")], 1)]
    best, _ = choose(possible, table, MATERIAL, table.draws(np.random.default_rng(1)))
    assert [e.key for one in best for e in one.model.effects] == told


def test_an_error_that_falls_but_not_for_sure_is_not_said_to_stay() -> None:
    for after, words in ((0.8, "but not significantly"), (23.0, "does not reduce")):
        table = table_of(23.5, after, agreement=[[0, 0], [20, -900]])
        assert words in shortfall(table, 1, MATERIAL)


def test_each_set_of_effects_is_measured_once_by_its_likeliest_fit() -> None:
    """Two fits of one set, from different starts, stood beside each other as rivals: an internal error."""
    single, again, pair = (explained(g, *e) for g, e in ((900.0, ("a",)), (950.0, ("a",)), (990.0, ("b", "a"))))
    assert shortlisted([single, again, pair, explained(980.0, "a", "b")]) == [again, pair]


@pytest.mark.parametrize(("before", "after", "verdict"), [
    (9.0, 1.2, "named"), (9.0, 1.4, "named"), (9.0, 2.2, "partial"), (9.0, 4.3, "partial"),
    (12.1, 9.4, "unexplained"),  # a spring for long bristles: it leaves more than it takes away
    (53.0, 3.6, "named")])  # the prismatic axis: a fifteenth of the error is left
def test_a_cause_that_leaves_much_is_named_in_part(before: float, after: float, verdict: str) -> None:
    """Nothing without a name lowers the residual error; yet it exceeds the noise floor and a tenth of the whole."""
    table = table_of(before, after)
    best = explained(900.0, "drag")
    asked = Decision("named", (best,), table, 1, (), 1, 0, best.model, table.draws(np.random.default_rng(1)))
    assert judge(asked, None, MATERIAL).verdict == verdict


def test_what_leaves_much_has_to_show_on_all_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """`partial` by the runs kept back alone is asked of the others, too; `named` is not."""
    best = explained(900.0, "drag")
    first, all_runs = table_of(9.0, 4.3), table_of(9.0, 8.8)

    def turned(_: object, asked: Decision, rng: np.random.Generator) -> tuple[Decision, dict[int, int]]:
        turns.append(asked)
        return replace(asked, table=all_runs, draws=all_runs.draws(rng)), {}

    turns: list[Decision] = []
    monkeypatch.setattr(verdict, "turn_runs", turned)
    monkeypatch.setattr(verdict, "by_error", list)
    monkeypatch.setattr(verdict, "admissible", lambda _: True)
    monkeypatch.setattr(verdict, "generic_extension", lambda *_: None)
    monkeypatch.setattr(verdict, "without_each", lambda *_: [])
    monkeypatch.setattr(verdict, "extend_errors", lambda table, more: table)
    monkeypatch.setattr(verdict, "over_floor", lambda table, *_: table)
    context = cast(Any, SimpleNamespace(nominal=None))
    for table, expected in ((first, "unexplained"), (table_of(9.0, 1.2), "named")):
        monkeypatch.setattr(verdict, "measure_together", lambda *_, table=table: table)
        found = verdict.decide(context, None, [best], MATERIAL, np.random.default_rng(1))
        assert found is not None and found.verdict == expected
    assert len(turns) == 1


def test_where_one_explanation_cannot_be_simulated_the_noise_of_another_is_the_unit(
        monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []

    def measured(models: list[str], reference: str, *_: object) -> str:
        tried.append(reference)
        if reference != "nominal":
            raise FitError("the replicates diverge")
        return f"in units of {reference}"

    monkeypatch.setattr(verdict, "measure_errors", measured)
    context = cast(Any, SimpleNamespace(split=SimpleNamespace(confirm=(1, 6))))
    found = verdict.measure_together(context, cast(Any, ["nominal", "first", "second"]), [0, 1],
                                     np.random.default_rng(0))
    assert found == "in units of nominal" and tried == ["first", "second", "nominal"]


def test_errors_that_are_known_are_not_measured_again(monkeypatch: pytest.MonkeyPatch) -> None:
    def extended(table: ErrorTable, more: list[Any]) -> ErrorTable:
        asked.extend(more)
        return replace(table_of(5.0, 2.0, 4.0, 3.0), models=(*table.models, *more))

    asked: list[Any] = []
    nominal, first, second, third = (object() for _ in range(4))
    known = replace(table_of(5.0, 2.0, 4.0), models=cast(Any, (nominal, first, second)),
                    unit=cast(Any, SimpleNamespace(reference=first)))
    monkeypatch.setattr(error_table, "extend_errors", extended)
    context = cast(Any, SimpleNamespace(split=None))
    found = verdict.measure_together(context, cast(Any, [nominal, first, third]), [0, 1],
                                     np.random.default_rng(0), [known])
    assert asked == [third] and [found.error(k) for k in range(3)] == pytest.approx([5.0, 2.0, 3.0])


def test_a_second_law_that_takes_up_a_difference_of_form_is_not_named() -> None:
    single, pair = explained(10_000.0, "load"), explained(10_400.0, "load", "play")
    table = table_of(7.1, 1.62, 1.47)
    best, row = choose([(single, 1), (pair, 2)], table, MATERIAL, table.draws(np.random.default_rng(1)))
    assert best == [single] and row == 1


def test_a_second_cause_that_makes_its_share_of_the_error_is_kept() -> None:
    single, pair = explained(10_000.0, "load"), explained(13_000.0, "load", "skew")
    table = table_of(5.0, 3.0, 1.1)
    best, row = choose([(single, 1), (pair, 2)], table, MATERIAL, table.draws(np.random.default_rng(1)))
    assert best == [pair] and row == 2


def test_a_second_cause_is_measured_by_what_the_first_leaves_however_large_that_is() -> None:
    """A wrong gyro scale beside an encoder's offset: 6.9, 3.7 by the offset alone, 1.4 by both; beside a first cause of
    ten times the error the same second one is named too."""
    single, pair = explained(10_000.0, "offset"), explained(13_000.0, "offset", "scale")
    for whole in (6.9, 69.0):
        table = table_of(whole, 3.7, 1.4)
        assert choose([(single, 1), (pair, 2)], table, MATERIAL, table.draws(np.random.default_rng(1))) == ([pair], 2)
    table = table_of(6.9, 3.7, 1.4, agreement=[[0, 0], [900, 900], [700, 800]])  # less likely with it
    assert choose([(single, 1), (pair, 2)], table, MATERIAL, table.draws(np.random.default_rng(1))) == ([single], 1)


def test_the_split_rotates_for_a_second_cause_only_where_it_may_be_material() -> None:
    """Beside a spring a late torque lowered the error by 15 %, in 80 % of the resamplings by what matters."""
    single, pair, other = (explained(10_000.0, "spring"), explained(10_900.0, "spring", "delay"),
                           explained(10_950.0, "drag", "delay"))
    table = table_of(9.0, 1.5, 1.25, 1.2)
    table.values[2, 4] *= 4.0**2  # one piece strays with both, and makes the fall unsure
    table.values[1, 4] *= 3.5**2
    asked = Decision("named", (single,), table, 1, (), 1, 0, None, table.draws(np.random.default_rng(1)))
    assert not is_material(table, 2, 1, MATERIAL, asked.draws)
    assert second_cause([(single, 1), (pair, 2), (other, 3)], asked, MATERIAL) == ([pair], 2)
    unlikely = table_of(9.0, 1.5, 1.25, agreement=[[0, 0], [900, 900], [700, 800]])
    assert second_cause([(single, 1), (pair, 2)], replace(asked, table=unlikely), MATERIAL) is None
    assert second_cause([(single, 1), (pair, 2)], replace(asked, table=table_of(9.0, 1.5, 1.4)), MATERIAL) is None


def test_no_error_counts_for_more_than_that_of_who_knows_nothing() -> None:
    """A piece that ran 1,439 rad away in a tenth of a second made all of an error."""
    errors = np.array([[4.0, 9.0], [1.0, 1.0]])
    assert np.allclose(_bounded([errors[:, None]], np.array([1.0, 2.0]), np.array([3.0, 1e9])),
                       [[[3.0, 4.5]], [[1.0, 0.5]]])


def test_shares_of_the_budget_add_up() -> None:
    table = table_of(5.0, 1.5, 3.0, 4.0)  # nominal, both causes, less the first, less the second

    @dataclass(frozen=True)
    class Cause:
        name: str
        joint: int | None

    model = cast(Any, type("M", (), {"named": (Cause("torque_delay", None), Cause("backlash", 1))}))
    rows = budget(table, 1, (2, 3), model, table.draws(np.random.default_rng(2)))
    assert [(r.what, r.effect, r.joint) for r in rows] == [
        ("nominal", None, None), ("cause", "torque_delay", None), ("cause", "backlash", 2), ("remainder", None, None),
        ("noise", None, None)]
    share = {r.what + (r.effect or ""): r.share for r in rows}
    assert share["nominal"] == 1.0
    assert share["causetorque_delay"] + share["causebacklash"] + share["remainder"] == pytest.approx(1.0)
    assert share["remainder"] == pytest.approx((1.5**2 - 1.0) / (5.0**2 - 1.0))
    # without the first 9 - 2.25 of error come back, without the second 16 - 2.25
    assert share["causebacklash"] / share["causetorque_delay"] == pytest.approx((16 - 2.25) / (9 - 2.25))
    assert share["noise"] == pytest.approx(1.0 / 24.0)
    assert all(r.ci95[0] <= r.share + 1e-9 and r.share <= r.ci95[1] + 1e-9 for r in rows)


def test_no_budget_is_made_of_noise() -> None:
    table = table_of(0.98, 0.97)
    assert budget(table, 1, (), None, table.draws(np.random.default_rng(0))) == ()


def test_a_leg_that_no_model_simulates_is_unexplained_and_not_undiagnosed(monkeypatch: pytest.MonkeyPatch) -> None:
    def diverge(*_: object) -> None:
        raise FitError("the free run diverges")

    monkeypatch.setattr(procedure, "decide", diverge)
    context = cast(DiagnosisContext, SimpleNamespace(split=None, nominal=None))
    found = procedure.conclude(context, Diagnosis("none", ""), None, [], np.random.default_rng(0))
    assert found.verdict == "unexplained" and "the free run diverges" in found.sentence and not found.causes


@pytest.mark.parametrize(("before", "expected"), [(1.05, "none"), (1.3, "none"), (1.9, "unexplained")])
def test_within_the_noise_floor_nothing_is_unexplained(before: float, expected: str) -> None:
    """Terms without a name take a fifth of the error away; it counts only where the error is beyond what is put down to
    noise. A healthy geared leg erred by 1.24 floors, of which a wave over the angle took a tenth."""
    table = table_of(before, before, 0.8 * before)
    best = explained(900.0, "drag")
    asked = Decision("named", (best,), table, 1, (), 1, 2, best.model, table.draws(np.random.default_rng(1)))
    assert judge(asked, cast(Any, best.model), MATERIAL).verdict == expected


@pytest.mark.parametrize(("before", "expected"), [(1.4, "none"), (1.9, "unexplained")])
def test_an_error_beyond_the_noise_floor_is_never_none(before: float, expected: str) -> None:
    table = table_of(before, before)
    best = explained(900.0, "drag")
    asked = Decision("named", (best,), table, 1, (), 1, 0, best.model, table.draws(np.random.default_rng(1)))
    assert judge(asked, None, MATERIAL).verdict == expected


@pytest.mark.parametrize(("after", "expected"), [(1.05, "named"), (1.3, "unexplained")])
def test_a_name_that_leaves_more_than_it_takes_away_is_refused(after: float, expected: str) -> None:
    """A cubic spring was named a linear one: 1.53 to 1.30 times the noise floor."""
    table = table_of(1.53, after)
    best = explained(900.0, "spring")
    asked = Decision("named", (best,), table, 1, (), 1, 0, best.model, table.draws(np.random.default_rng(1)))
    assert judge(asked, None, MATERIAL).verdict == expected


@pytest.mark.parametrize(("before", "expected"), [(1.4, "none"), (1.6, "unexplained")])
def test_a_refused_name_is_unexplained_beyond_the_noise_alone(before: float, expected: str) -> None:
    best = explained(900.0, "skew")
    asked = Decision("named", (best,), table_of(before, 1.05, 1.0), 1, (), 1, 2, best.model,
                     np.random.default_rng(1).integers(0, BLOCKS, (9, BLOCKS)))
    found = unnamed(replace(asked, judged=asked), best.model, MATERIAL, "it imitates")
    assert found.verdict == expected and found.judged is None and found.best == ((best,) if before > 1.5 else ())
    assert expected == "none" or found.why == "it imitates"


@pytest.mark.parametrize(("before", "one", "other", "expected"), [
    (1.32, 1.16, 1.18, "none"), (1.45, 1.28, 1.3, "named"), (1.9, 1.16, 1.18, "named")])
def test_small_faults_that_are_material_only_together_are_no_cause(
        before: float, one: float, other: float, expected: str) -> None:
    """A healthy geared leg had a bias of its gyro, a zero of its encoder and a cogging gear. Together they made 1.31
    floors of 1.11."""
    table = table_of(before, 1.1, one, other, agreement=[[0, 0], [90, 90], [40, 40], [50, 50]])
    best = explained(900.0, "bias", "zero")
    asked = Decision("named", (best,), table, 1, (2, 3), 1, 0, best.model, table.draws(np.random.default_rng(1)))
    found = judge(asked, None, MATERIAL)
    assert found.verdict == expected and found.best == (best,)


@pytest.mark.parametrize(("generic", "told"), [(1.0, True), (1.28, False)])
def test_structure_within_the_noise_floor_is_told_only_if_it_is_material(generic: float, told: bool) -> None:
    """Every model with generic terms said where a residual is, also one whose terms change no simulation."""
    table = table_of(1.3, 1.3, generic)
    best = explained(900.0, "drag")
    asked = Decision("named", (best,), table, 1, (), 1, 2, best.model, table.draws(np.random.default_rng(1)))
    found = judge(asked, best.model, MATERIAL)
    assert found.verdict == "none" and (found.terms is best.model) is told


@pytest.mark.parametrize(("without", "kept"), [
    ((1.25, 9.0), 1), ((2.0, 9.0), 2), ((1.25, 1.26), 1)])  # of the last two either would do: one goes
def test_what_is_not_material_in_a_set_is_left_out(without: tuple[float, float], kept: int,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    """A torque offset made half of a leg's error and a bias a hundredth: the offset alone is the answer."""
    pair = explained(900.0, "offset", "bias")
    table = replace(table_of(9.0, 1.2, *without), models=cast(Any, [None, pair.model, *(
        Fitted((cast(Any, Named(key)),)) for key in ("offset", "bias"))]))
    asked = Decision("named", (pair,), table, 1, (2, 3), 1, 0, None, table.draws(np.random.default_rng(1)))

    def ask(_: object, begin: Decision, what: Any, *__: object) -> Decision:
        return replace(begin, best=tuple(what[0]), row=what[1], without=())

    monkeypatch.setattr(verdict, "ask", ask)
    monkeypatch.setattr(verdict, "assess", lambda _, some: [replace(e, left=NOTHING_LEFT) for e in some])
    monkeypatch.setattr(verdict, "deviance", lambda model: -450.0 * len(model.effects))
    found = verdict.pruned(cast(Any, None), asked, [], MATERIAL, np.random.default_rng(1))
    assert len(found.best[0].model.effects) == kept
    if kept == 1:
        assert found.best[0].model.effects[0].key == "offset" and found.best[0].gain == 450.0
    small = replace(asked, table=replace(table, values=table.values * (1.4 / 9.0) ** 2))
    assert verdict.pruned(cast(Any, None), small, [], MATERIAL, np.random.default_rng(1)) is small
