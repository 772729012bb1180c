"""Which sets of effects are found, and when more effects at once are tried."""

from dataclasses import replace

import numpy as np
from pytest import MonkeyPatch, approx, mark, raises

from estimator import FitError
from estimator.diagnosis import search
from estimator.diagnosis.context import Start, assess, assess_answers
from estimator.diagnosis.decision_rule import GROWN, WIDTH
from estimator.diagnosis.explanation import Explanation, by_error, first_of_each
from estimator.diagnosis.model import Model, gain_over
from estimator.diagnosis.train_errors import floor_of_best, left_out_runs
from estimator.effects import StribeckFriction, TorqueDelay
from estimator.effects.quadratic_drag import QuadraticDrag
from tests.support.driven_pendulum import searched
from tests.support.stated_fits import Named, explained, predicted_by_scores
from tests.support.stated_tables import table_of

DRAG, SPRING = 0.03, 0.4


def keys_of(start: Start) -> list[str]:
    return [effect.key for effect, _ in start]


def test_hidden_causes_are_found_each_set_once_the_likeliest_first() -> None:
    found = searched(drag=DRAG, spring=SPRING).found
    assert found[0].keys == {"quadratic_drag@1", "joint_stiffness@1"}
    sizes = dict(zip((e.key for e in found[0].model.effects), found[0].model.sizes()))
    assert sizes["quadratic_drag@1"][0] == approx(DRAG, rel=0.02)
    assert sizes["joint_stiffness@1"][0] == approx(SPRING, rel=0.02)
    assert len({e.keys for e in found}) == len(found) and {len(e.keys) for e in found} == {1, 2}
    assert [e.gain for e in found] == sorted((e.gain for e in found), reverse=True)
    assert found[0].error == min(e.error for e in found) < 0.1


def test_no_larger_set_is_sought_after_what_leaves_nothing() -> None:
    found = searched(drag=DRAG).found
    assert found[0].keys == {"quadratic_drag@1"} and max(len(e.keys) for e in found) == 1


def test_sets_that_are_the_likeliest_after_a_few_steps_are_kept() -> None:
    one = searched(drag=DRAG)
    starts = search.grown(one.context, [Explanation(one.context.nominal, 0.0, one.tests)])
    kept = search.tried(one.context, starts[::-1])
    gains = [-m.log_marginal for m, _ in kept]
    assert len(kept) == WIDTH < len(starts) and gains == sorted(gains)
    assert keys_of(kept[0][1]) == ["quadratic_drag@1"] and len({tuple(keys_of(s)) for _, s in kept}) == WIDTH
    assert all(np.array_equal(size, m.sizes()[0]) for m, [(_, size)] in kept)  # a fit goes on from there


def test_no_fit_from_the_nominal_model_is_made_twice(monkeypatch: MonkeyPatch) -> None:
    one = searched(drag=DRAG)
    context = replace(one.context, whole={})
    starts: list[tuple[Model, Start]] = [
        (context.nominal, [(QuadraticDrag(0), np.zeros(1))]),
        (context.nominal, [(StribeckFriction(0), np.array([0.0, 0.2, 2.0]))])]
    found = search.fit_sets(context, starts)
    assert found[0].keys == {"quadratic_drag@1"}
    assert set(context.whole) == {search.key_of(s) for _, s in starts}
    monkeypatch.setattr(search, "fit_held", None)
    again = search.fit_sets(context, starts[::-1])
    assert [e.model.log_marginal for e in again] == [e.model.log_marginal for e in found]
    assert search.fit_sets(context, []) == []


def test_what_is_not_significant_in_a_set_is_left_out() -> None:
    """A tilted IMU was found only with a bias that was zero."""
    context = searched(drag=DRAG).context
    start = [(QuadraticDrag(0), np.zeros(1)), (TorqueDelay(), np.zeros(1))]
    both = assess(context, search.fit_sets(context, [(context.nominal, start)]))
    (alone,) = search.reduced(context, both)
    assert both[0].keys > alone.keys == {"quadratic_drag@1"}
    assert search.reduced(context, [alone]) == []


def test_one_effect_more_is_sought_in_what_an_explanation_leaves() -> None:
    one = searched(drag=DRAG, spring=SPRING)
    drag = next(e for e in one.found if e.keys == {"quadratic_drag@1"})
    more = search.with_one_more(one.context, drag)
    assert more[0].keys == {"quadratic_drag@1", "joint_stiffness@1"}
    own = gain_over(drag.model, more[0].model) / drag.left.scatter
    assert more[0].gain == approx(own) and own > one.context.least_gain
    assert [e.gain for e in more] == sorted((e.gain for e in more), reverse=True)


def test_sets_that_cannot_be_answers_are_not_assessed() -> None:
    """A likelier set that simulates better excludes one, unless a further effect may level them, here by 160, or the
    likelier one is not significant."""
    def found(size: float) -> list[float]:
        best = explained(2000.0, "play", error=0.5, further=[160.0], size=size)
        sets = [explained(100.0, "drag", "skew", error=0.9), explained(800.0, "skew", error=0.4),
                explained(900.0, "drag", error=0.7), explained(1850.0, "gear", error=0.6, size=size)]
        return [e.gain for e in assess_answers(predicted_by_scores({Named("play"): 1.0})[0], sets, [best])]

    assert found(9.0) == [2000.0, 1850.0, 800.0, 100.0]
    assert found(1.0) == [2000.0, 1850.0, 900.0, 800.0, 100.0]


def test_sets_grow_by_what_each_leaves_and_each_set_once() -> None:
    effects = [Named(f"e{k:02}") for k in range(GROWN + 4)]
    context, left = predicted_by_scores({effect: 100.0 - k for k, effect in enumerate(effects)})
    parents = [replace(explained(gain, name), left=left) for gain, name in ((50.0, "e00"), (10.0, "e01"))]
    starts = search.grown(context, parents)
    sets = [frozenset(keys_of(start)) for _, start in starts]
    assert len(sets) == len(set(sets)) == 2 * GROWN - 1 and sets[0] == {"e00", "e01"}  # which both lead to
    assert starts[0][0] is parents[0].model  # the likelier


def test_every_effect_is_predicted_at_the_nominal_model_and_other_first_sizes_too() -> None:
    context, left = predicted_by_scores({Named("skew", starts=((0.02,), (-0.02,))): 4.0, Named("drag"): 9.0})
    starts = search.grown(context, [Explanation(context.nominal, 0.0, left)])
    assert [(keys_of(s), float(s[0][1][0])) for _, s in starts] == [
        (["drag"], 3.0), (["skew"], 2.0), (["skew"], 0.02), (["skew"], -0.02)]


def promised(monkeypatch: MonkeyPatch, errors: dict[int, float]) -> search.Promise:
    """Of the pendulum's drag, and of it with the spring, whose free runs, by the number of effects, err by so many
    floors."""
    one = searched(drag=DRAG, spring=SPRING)
    of_count = {len(e.keys): e for e in one.found if "quadratic_drag@1" in e.keys}
    found = [replace(of_count[count], error=error) for count, error in errors.items() if count]
    values = np.array([errors[0], *(e.error for e in by_error(first_of_each(found)))])
    table = table_of(*values)
    monkeypatch.setattr(search, "train_table", lambda *_: table)
    return search.promise(replace(one.context, rng=np.random.default_rng(0)), found)


@mark.parametrize("errors, promising", [
    ({0: 1.9, 1: 1.35}, True), ({0: 1.9, 1: 1.05}, False),  # room above noise for a second effect, and none
    ({0: 1.9, 1: 1.35, 2: 1.32}, False),  # a late torque; friction near rest with it lowers next to nothing
    ({0: 9.0, 1: 2.5, 2: 1.4}, True),
    ({0: 9.0, 1: 9.0}, True), ({0: 9.0, 1: 4.5, 2: 4.5}, False),  # one effect may hide another
    ({0: 9.0, 1: 1.05, 2: 0.9}, False)])  # no room above noise
def test_more_effects_are_tried_where_the_last_lowers_the_error(monkeypatch: MonkeyPatch,
                                                                errors: dict[int, float], promising: bool) -> None:
    assert promised(monkeypatch, errors).larger is promising


def test_a_train_run_is_predicted_by_the_fit_to_the_others() -> None:
    """A drag that one run alone has: the fit to the others errs more on it than the fit to all."""
    one = searched(drag=DRAG)
    context = replace(one.context, rng=np.random.default_rng(0))
    best = replace(one.found[0], model=replace(one.found[0].model))
    fold = context.split.inner[0]
    left = left_out_runs(best.model, best.scores, fold)
    assert set(left) == set(fold) and best.model.made["left out"] is left
    assert left_out_runs(best.model, best.scores, fold)[fold[0]] is left[fold[0]]  # once
    biased = [replace(s, score=s.score + (3.0 if run in fold else -3.0) * s.scale)
              for s, run in zip(best.scores, context.split.train)]
    other = left_out_runs(replace(best.model), biased, fold)
    assert np.nanmax(np.abs(other[fold[0]].simulated - left[fold[0]].simulated)) > 0.0


def test_where_nothing_can_be_simulated_more_is_tried() -> None:
    one = searched(drag=DRAG)
    beta = one.context.nominal.state.beta.copy()
    beta[2] = -5.0  # friction that drives
    wild = replace(one.context.nominal, state=replace(one.context.nominal.state, beta=beta))
    context = replace(one.context, nominal=wild)
    with raises(FitError, match="diverges"):
        floor_of_best(context, [])
    lost = replace(one.found[0], model=wild)
    assert search.promise(context, [lost]) == (True, True)
