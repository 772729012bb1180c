"""Which sets of effects are fitted, and when more effects at once are tried."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from estimator.diagnosis import assessment, procedure, search
from estimator.diagnosis.context import Explanation, keys_of, seated
from estimator.diagnosis.decision_rule import GROWN, MATERIAL, WIDTH
from estimator.errors import FitError
from estimator.score import NO_TESTS
from tests.support.stated_fits import Context, Fitted, Named, explained, fitted


@pytest.fixture(autouse=True)
def no_likelihood(monkeypatch: pytest.MonkeyPatch) -> None:
    """Deviances and shapes are stated."""
    def shapes(context: Any, _: object, skip: Any = ()) -> list[int]:
        every = range(len(context.candidates))
        return sorted((i for i in every if context.candidates[i].effect.key not in skip),
                      key=lambda i: -context.gain(None, i))

    monkeypatch.setattr(search, "deviance", lambda model: model.deviance)
    monkeypatch.setattr(search, "best_shapes", shapes)
    monkeypatch.setattr(search, "start_size", lambda *_: np.zeros(1))
    monkeypatch.setattr(search, "short_errors", lambda _: np.ones(1))
    monkeypatch.setattr(search, "relative", lambda *_: 1.0)
    for module in (search, assessment):
        monkeypatch.setattr(module, "assess", lambda _, explanations: list(explanations))
        monkeypatch.setattr(module, "admissible", lambda _: True)


def test_the_last_place_is_for_what_simulates_best() -> None:
    """A geared leg's IMU, 3 mrad askew: gain 5,482, and friction that moves the leg: gain 972."""
    every = (5482.0, "askew", 0.993), (5400.0, "biased", 0.993), (4000.0, "stiff", 1.002), (972.0, "stribeck", 0.927)
    found = [replace(explained(gain, name), error=error) for gain, name, error in every]
    bristles = replace(explained(1469.0, "bristles"), error=0.5,
                       model=cast(Any, Fitted((Named("bristles"),), -1469.0, at_limit=True)))
    askew, biased, _, stribeck = found
    assert seated([*found, bristles], 2) == [askew, stribeck]
    assert seated([askew, stribeck, biased], 2) == [askew, stribeck] and seated(found, 4) == found
    assert seated([bristles], 2) == [bristles] and seated([], 2) == []


def test_sets_that_gain_are_fitted_to_the_end_and_those_that_prove_likely_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """An IMU 4 ms late hid behind the nominal fit: six effects had larger scores, and none came near it in two steps.
    A rotor's inertia had the largest score, and two steps led nowhere."""
    context = Context({f"other{k}": 100.0 - k for k in range(6)} | {"skew": 5.0, "drag": 1.0, "play": 0.5})
    starts = search.grown(cast(Any, context), [explained(0.0)])
    assert [e.key for _, [(e, _)] in starts][:WIDTH] == [f"other{k}" for k in range(WIDTH)]
    tried, whole = [], []

    def held(_: object, begin: object, start: Any, steps: int) -> Any:
        tried.append(start[0][0].key)
        return fitted(9000.0 if tried[-1] == "skew" else 10.0, tried[-1])

    def fit(_: object, begin: object, start: Any) -> Any:
        whole.append(start[0][0].key)
        return fitted(10_000.0 if whole[-1] == "skew" else 500.0, whole[-1])

    monkeypatch.setattr(search, "_each", lambda _, starts, work: [work(k) for k in range(len(starts))])
    monkeypatch.setattr(search, "fit_held", held)
    monkeypatch.setattr(search, "fit_whole", fit)
    monkeypatch.setattr(search, "weigh", lambda _, found: found)
    monkeypatch.setattr(search, "exchanged", lambda *_: [])
    monkeypatch.setattr(search, "reduced", lambda *_: [])
    left = explained(0.0).left
    found = search.search(cast(Any, context), left, lambda *_: None, lambda _: search.Promise(True, False))
    assert len(tried) == len(starts) - WIDTH and len(whole) == 2 * WIDTH
    assert keys_of(found[0]) == {"skew"} and found[0].gain == 10_000.0
    tried.clear()
    search.search(cast(Any, context), left, lambda *_: None, lambda _: search.Promise(False, False))
    assert not tried  # nothing can be better


def test_shapes_are_free_in_the_likeliest_set_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    gains = {"drag": 50.0, "play": 900.0}
    freed: list[Any] = []
    begun: list[str] = []

    def held(_: object, begin: object, start: Any, steps: int) -> Any:
        begun.append(start[0][0].key)
        return fitted(gains[start[0][0].key], start[0][0].key)

    def free(model: Any) -> Any:
        freed.append(model)
        return model

    monkeypatch.setattr(search, "_each", lambda _, starts, work: [work(k) for k in range(len(starts))])
    monkeypatch.setattr(search, "fit_held", held)
    monkeypatch.setattr(search, "fit_free", free)
    context = cast(Any, Context(gains))
    starts = search.grown(context, [explained(0.0)])
    found = search.fit_likeliest(context, starts)
    assert found is not None and [e.key for e in found.effects] == ["play"] and freed == [found]
    assert search.fit_likeliest(context, []) is None
    again = {start[0][0].key: search.fit_whole(context, begin, start) for begin, start in starts}
    assert again["play"] is found and sorted(begun) == ["drag", "play"]  # no fit is made twice
    assert [e.key for e in freed[-1].effects] == ["drag"] and len(freed) == 2
    other = [(effect, size + 0.1) for effect, size in starts[0][1]]
    assert search.fit_whole(context, starts[0][0], other) is not None and len(begun) == 3


@pytest.mark.parametrize(("residuals", "sizes"), [((False, False), 1), ((False, True), 2), ((True, False), 2)])
def test_larger_sets_follow_while_one_of_the_best_leaves_something(residuals: tuple[bool, bool], sizes: int,
                                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    """A skew was the likeliest and left nothing under its noise levels; drag moved the leg and left a little."""
    grown: list[int] = []

    def fit(_: object, starts: Any) -> list[Explanation]:
        grown.append(len(starts[0][1]))
        return [replace(explained(9.0 - k, *(e.key for e, _ in start)), has_residual=residuals[k] and grown[-1] == 1)
                for k, (_, start) in enumerate(starts[:2])]

    monkeypatch.setattr(search, "fit_sets", fit)
    monkeypatch.setattr(search, "weigh", lambda _, found: found)
    for name in ("exchanged", "reduced", "tried"):
        monkeypatch.setattr(search, name, lambda *_: [])
    context = Context({"skew": 9.0, "drag": 8.0, "play": 1.0})
    search.search(cast(Any, context), explained(0.0).left, lambda *_: None, lambda _: search.Promise(False, True))
    assert max(grown) == sizes


def test_all_fitted_sets_are_compared_that_can_be_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scales of an arm's two encoders fitted alike, and one had no place among the parents. Gears of impossible
    friction were likelier; under their noise levels and scatter a gain of 754 became 3.4, and its p-value 1."""
    gains = {"gear": 1917.0, "play": 1255.0, "gear1": 677.0, "scale2": 819.0, "scale1": 754.0, "friction": 356.0}

    def fit(*_: object) -> list[Explanation]:
        return [explained(gains[key], key) for key in next(whole)]

    def compared(_: object, found: list[Explanation]) -> list[Explanation]:
        return sorted(found, key=lambda e: -e.gain)

    monkeypatch.setattr(search, "fit_sets", fit)
    monkeypatch.setattr(search, "weigh", compared)
    for name in ("exchanged", "reduced", "tried"):
        monkeypatch.setattr(search, name, lambda *_: [])
    context, left = cast(Any, Context(dict(gains))), explained(0.0).left
    for impossible, expected in ((("gear", "play", "gear1"), ["scale2", "scale1", "friction"]),
                                 (tuple(gains), sorted(gains, key=lambda key: -gains[key]))):
        whole = iter((("gear", "play", "gear1"), ("scale2", "scale1", "friction")))
        for module in (search, assessment):
            monkeypatch.setattr(module, "admissible", lambda e, gone=impossible: not keys_of(e) & set(gone))
        found = search.search(context, left, lambda *_: None, lambda _: search.Promise(True, False))
        assert [next(iter(keys_of(e))) for e in found] == expected


def test_sets_of_as_many_effects_share_one_bias(monkeypatch: pytest.MonkeyPatch) -> None:
    simulated: list[int] = []

    def bootstrap(model: Fitted, *_: object) -> list[str]:
        simulated.append(len(model.effects))
        if len(simulated) == 1:
            raise FitError("no replicate is like its run")
        return [f"bias of {len(model.effects)}"]

    monkeypatch.setattr(assessment, "bootstrap_scores", bootstrap)
    monkeypatch.setattr(assessment, "drop_size_entries", lambda bias, model: bias)
    context = cast(Any, SimpleNamespace(biases={}, bias=["nominal"], candidates=[], rng=None))
    models = [fitted(0.0, *keys) for keys in (("drag",), ("play",), ("drag", "play"), ("skew",), ("drag", "skew"))]
    found = [assessment.bias_of(context, cast(Any, m), []) for m in models]
    assert found == [["nominal"], ["bias of 1"], ["bias of 2"], ["bias of 1"], ["bias of 2"]]
    assert simulated == [1, 1, 2]


def test_sets_that_cannot_be_answers_are_not_assessed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A likelier set that simulates better excludes one, unless a further effect may level them, here by 160, or the
    likelier one has an impossible sign."""
    best, tied, worse, clear = (replace(explained(gain, key), error=error) for gain, key, error in (
        (2000.0, "play", 0.5), (1850.0, "gear", 0.6), (900.0, "drag", 0.7), (800.0, "skew", 0.4)))
    pair = replace(explained(100.0, "drag", "skew"), error=0.9)
    best = replace(best, further=np.array([160.0]))
    monkeypatch.setattr(assessment, "admissible", lambda e: True)
    found = assessment.assess_answers(cast(Any, Context()), [pair, clear, worse, tied], [best])
    assert [e.gain for e in found] == [2000.0, 1850.0, 800.0, 100.0]
    monkeypatch.setattr(assessment, "admissible", lambda e: keys_of(e) != {"play"} and keys_of(e) != {"gear"})
    found = assessment.assess_answers(cast(Any, Context()), [pair, clear, worse, tied], [best])
    assert [e.gain for e in found] == [2000.0, 1850.0, 900.0, 800.0, 100.0]


def test_sets_grow_by_what_each_leaves_and_each_set_once() -> None:
    context = Context({f"e{k:02}": 100.0 - k for k in range(GROWN + 4)})
    parents = [explained(50.0, "e00"), explained(10.0, "e01")]
    starts = search.grown(cast(Any, context), parents)
    sets = [frozenset(e.key for e, _ in start) for _, start in starts]
    assert len(sets) == len(set(sets)) == 2 * GROWN - 1 and sets[0] == {"e00", "e01"}  # which both lead to
    assert starts[0][0] is parents[0].model  # the likelier


def test_other_first_sizes_of_an_effect_are_tried_too() -> None:
    context = Context({"skew": 2.0, "drag": 1.0}, {"skew": ((0.02,), (-0.02,))})
    starts = search.grown(cast(Any, context), [explained(0.0)])
    assert [float(size[0]) for _, [(_, size)] in starts] == [0.0, 0.0, 0.02, -0.02]


def test_what_is_not_significant_in_a_set_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tilted IMU was found only with a bias that was zero."""
    monkeypatch.setattr(search, "presence", lambda e: [one.key == "tilt" for one in e.model.effects])
    monkeypatch.setattr(search, "undetermined", lambda e: [False for _ in e.model.effects])
    monkeypatch.setattr(search, "fit_sets", lambda _, starts: [
        Explanation(fitted(1.0, *(e.key for e, _ in start)), 1.0) for _, start in starts])
    both, alone = explained(900.0, "tilt", "bias"), explained(900.0, "tilt")
    assert [keys_of(e) for e in search.reduced(cast(Any, Context()), [both, alone])] == [{"tilt"}]


def test_an_effect_is_exchanged_for_one_that_replaces_it(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    context = Context({"spring": 3.0, "offset": 2.0, "friction": 1.0, "skew": 0.5})
    monkeypatch.setattr(search, "replaces", lambda context, tests, i, k: i < 3 and k < 3)
    monkeypatch.setattr(search, "tried", lambda _, starts: starts)
    monkeypatch.setattr(search, "fit_sets", lambda _, starts: asked.extend(starts) or [])
    found = [explained(9.0, "spring"), explained(8.0, "offset")]
    assert search.exchanged(cast(Any, context), NO_TESTS, found) == []
    assert [[e.key for e, _ in start] for _, start in asked] == [["friction"]]


def test_gains_are_those_over_the_likeliest_smaller_set() -> None:
    spring, offset, both = explained(9.0, "spring"), explained(7.0, "offset"), explained(12.0, "offset", "spring")
    pair = search.with_parent(both, [both, spring, offset])
    assert pair.gain_over_parent == 3.0
    assert search.with_parent(spring, [both, spring, offset]).gain_over_parent == 9.0


@pytest.mark.parametrize("errors, promising", [
    ({0: 1.9, 1: 1.35}, True), ({0: 1.9, 1: 1.05}, False),  # room above noise for a second effect, and none
    ({0: 1.9, 1: 1.35, 2: 1.32}, False),  # a late torque; friction near rest with it lowers next to nothing
    ({0: 9.0, 1: 2.5, 2: 1.4}, True),
    ({0: 9.0, 1: 9.0}, True), ({0: 9.0, 1: 4.5, 2: 4.5}, False),  # one effect may hide another
    ({0: 9.0, 1: 1.05, 2: 0.9}, False)])  # no room above noise
def test_more_effects_are_tried_where_the_last_lowers_the_error(
        errors: dict[int, float], promising: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def measured(models: list[Fitted], *_: object, **__: object) -> Any:
        return SimpleNamespace(error=lambda k: errors[len(models[k].effects)])

    monkeypatch.setattr(procedure, "measure_errors", measured)
    monkeypatch.setattr(procedure, "noise_floor", lambda _: None)
    monkeypatch.setattr(procedure, "by_error", list)
    found = [e for e in (explained(1.0, "delay", "play"), explained(1.0, "delay")) if len(e.model.effects) in errors]
    known: list[Any] = []
    rng = np.random.default_rng(0)
    promised = procedure.promise(cast(Any, Context()), found, None, MATERIAL, rng, known)
    assert promised.larger is promising and len(known) == 1


def test_where_nothing_can_be_simulated_more_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    def diverged(*_: object, **__: object) -> None:
        raise FitError("the free run diverges")

    monkeypatch.setattr(procedure, "measure_errors", diverged)
    monkeypatch.setattr(procedure, "noise_floor", lambda _: None)
    monkeypatch.setattr(procedure, "by_error", list)
    found = [explained(1.0, "delay")]
    assert procedure.promise(cast(Any, Context()), found, None, MATERIAL, np.random.default_rng(0), []) == (True, True)


def test_a_wrong_effect_does_not_set_the_noise_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    """An IMU 3.5 ms late: under the floor of a tilted IMU the error was 1.001, under that of generic terms 1.51."""
    generic, error = fitted(0.0, "wave"), {"tilt": 1.001, "wave": 1.51}

    def measured(*_: object, noise: Fitted) -> Any:
        return SimpleNamespace(error=lambda k: error[noise.effects[0].key])

    monkeypatch.setattr(procedure, "measure_errors", measured)
    monkeypatch.setattr(procedure, "noise_floor", lambda model: model)
    monkeypatch.setattr(procedure, "by_error", list)
    context, rng = cast(Any, Context()), np.random.default_rng(0)
    for model, better in ((None, False), (cast(Any, generic), True)):
        assert procedure.promise(context, [explained(1.0, "tilt")], model, MATERIAL, rng, []).better is better
