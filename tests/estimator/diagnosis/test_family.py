"""What the train runs say of an answer before any test run is looked at."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from estimator.diagnosis import family
from estimator.diagnosis.context import DiagnosisContext
from estimator.diagnosis.data_split import folds
from estimator.diagnosis.explanation import Explanation
from estimator.diagnosis.family import imitates, present_too, with_terms
from estimator.diagnosis.model import Model
from estimator.diagnosis.search import with_one_more
from estimator.effects import Effect
from estimator.errors import FitError
from tests.support.stated_fits import Named, explained, fitted, predicted_by_scores


def context() -> DiagnosisContext:
    """Gains of less than 120 are not looked at; the nominal model's log likelihood is 0."""
    return predicted_by_scores({Named("delay"): 4230.0})[0]


def more_than(spring: Explanation, gains: dict[str, float], further: dict[str, float] | None = None,
              has_residual: bool = True) -> list[Explanation]:
    """Sets of the spring and one effect, with their gains over it, the likeliest first, and what explains more."""
    return [replace(explained(gain, "spring", key, further=[(further or {}).get(key, 0.0)], has_residual=has_residual),
                    model=fitted(spring.gain + gain, "spring", key))
            for key, gain in sorted(gains.items(), key=lambda one: -one[1])]


@pytest.mark.parametrize(("gains", "further", "there"), [
    ({"delay": 4230.0, "ripple": 400.0}, {}, True),
    ({"delay": 100.0}, {}, False),  # too little to look at
    ({"delay": 4230.0, "bias": 4228.0}, {}, False),  # not told apart
    ({"delay": 4230.0, "bias": 4100.0}, {"delay": 300.0, "bias": 500.0}, False),
    ({"delay": 4230.0}, {"delay": 4231.0}, False),  # an arm's play: another term explains more
    ({}, {}, False)])
def test_an_effect_in_addition_is_present_where_nothing_else_explains_as_much(
        gains: dict[str, float], further: dict[str, float], there: bool) -> None:
    spring = explained(9000.0, "spring")
    found = present_too(context(), spring, more_than(spring, gains, further))
    assert (None if found is None else found.keys) == ({"spring", "delay"} if there else None)


def test_an_effect_in_addition_that_is_not_significant_is_not_present() -> None:
    """The next likeliest may be."""
    spring = explained(9000.0, "spring")
    delay, ripple = more_than(spring, {"delay": 4230.0, "ripple": 400.0})
    delay = replace(delay, model=fitted(13_230.0, "spring", "delay", size=1.0))
    found = present_too(context(), spring, [delay, ripple])
    assert found is ripple and present_too(context(), spring, [delay]) is None


def test_what_one_further_effect_explains_more_than_is_an_imitation() -> None:
    """An encoder's offset that the library lacked: an eccentricity gained 20,820, a spring with it 26,249 more."""
    spring, asked = explained(9000.0, "spring"), context()
    for gain, imitated in ((8999.0, False), (9001.0, True)):
        assert imitates(asked, spring, more_than(spring, {"stiffness": gain})) is imitated
        by_score = replace(spring, further=explained(0.0, further=[gain]).further)  # of a generic term, say
        assert imitates(asked, by_score, []) is imitated
    assert not imitates(asked, spring, [])
    second = more_than(spring, {"scale": 9001.0}, has_residual=False)  # a cause
    assert not imitates(asked, spring, second)
    asked.nominal = cast(Model, SimpleNamespace(log_marginal=4550.0))  # it is likelier
    assert imitates(asked, spring, [])


def test_nothing_is_sought_in_addition_to_what_leaves_nothing() -> None:
    assert with_one_more(context(), explained(9.0, "spring")) == []


@pytest.mark.parametrize("less", [True, False])
def test_a_term_that_slow_torque_asks_for_stays_where_left_out_runs_surely_err_less(
        less: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A gyro's bias and an offset of the torque: the fit's model has the offset, so the diagnosis' has it too."""
    bias, offset = Named("bias"), Named("offset")
    asked, best = context(), replace(explained(9000.0, bias), within=frozenset())
    assert with_terms(asked, best, asked.terms) is best  # nothing asks
    asked.terms = cast(Sequence[Effect], [bias, offset])
    again = fitted(9400.0, bias, offset)
    monkeypatch.setattr(family, "refit", lambda model, pairs: again if [e for e, _ in pairs] == [bias, offset] else 0)
    monkeypatch.setattr(family, "surely_errs_less", lambda one, two, _: less and (one, two) == (again, best.model))
    monkeypatch.setattr(family, "assess", lambda _, some: [
        replace(explained(9000.0, bias, offset), model=one.model, left=best.left) for one in some])
    found = with_terms(asked, best, asked.terms)
    if not less:
        assert found is best
        return
    assert found.model is again and found.beyond == {"bias"} and found.within == {"offset"}
    assert found.gain == pytest.approx(9000.0 + 400.0 / best.left.scatter)


def test_a_term_of_no_size_is_not_told_as_present(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slow torque asked for an offset, and a rotor's inertia explained all of it."""
    rotor, offset = Named("rotor"), Named("offset")
    asked, best, fits = context(), explained(9000.0, "bias"), list[set[str]]()

    def refitted(model: object, pairs: Sequence[tuple[Named, object]]) -> Model:
        fits.append({e.key for e, _ in pairs})
        again = fitted(9400.0, *(e for e, _ in pairs))
        sizes = [np.array([0.5 if e is offset else 9.0]) for e, _ in pairs]
        return cast(Model, SimpleNamespace(effects=again.effects, named=again.effects, log_marginal=4700.0,
                                           sizes=lambda: sizes, places=again.places, std=again.std))

    def assessed(_: object, some: Sequence[Explanation]) -> list[Explanation]:
        return [replace(explained(9400.0, *(e.key for e in one.model.effects)), model=one.model) for one in some]

    monkeypatch.setattr(family, "refit", refitted)
    monkeypatch.setattr(family, "surely_errs_less", lambda *_: True)
    monkeypatch.setattr(family, "assess", assessed)
    found = with_terms(asked, best, cast(Sequence[Effect], [rotor, offset]))
    assert fits == [{"bias", "rotor", "offset"}, {"bias", "rotor"}] and found.keys == {"bias", "rotor"}


def test_a_term_that_cannot_be_fitted_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, best = context(), explained(9000.0, "bias")
    asked.terms = cast(Sequence[Effect], [Named("offset")])

    def fails(*_: object) -> None:
        raise FitError("no")

    monkeypatch.setattr(family, "refit", fails)
    assert with_terms(asked, best, asked.terms) is best


@pytest.mark.parametrize("count", range(2, 14))
def test_each_run_is_held_out_once_and_never_all(count: int) -> None:
    groups = folds(count)
    assert sorted(k for g in groups for k in g) == list(range(count))
    assert all(0 < len(g) < count for g in groups) and len(groups) > 1


def test_of_four_neighbours_in_excitation_one_is_in_each_group() -> None:
    assert folds(8) == [(1, 6), (2, 7), (3, 4), (0, 5)]
