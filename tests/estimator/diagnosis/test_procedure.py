"""The pipe of a diagnosis on a driven pendulum: the train runs choose, the test runs judge."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng

from estimator import FitError
from estimator.diagnosis import MATERIAL, procedure
from estimator.diagnosis.account import base, describe
from estimator.diagnosis.decision_rule import DECIDING_S
from estimator.diagnosis.family import measure_all, measure_first
from estimator.diagnosis.gain import gains_by_horizon
from estimator.diagnosis.procedure import Begun, with_smoothing_velocity
from estimator.diagnosis.train_errors import floor_of_best, surely_errs_less, train_table
from estimator.diagnosis.verdict import UNCHANGED, decide, probability_of
from estimator.model import joint1
from estimator.verdicts import Verdict
from tests.support.driven_pendulum import SMOOTHING, Searched, mechanism, pendulum_runs, search_runs, searched

DRAG, SPRING = 0.03, 0.4


def what_was_found(one: Searched) -> list[tuple[object, ...]]:
    """Everything that the search and the family state, and the errors that they choose by."""
    family, context = one.family, replace(one.context, rng=default_rng(0))
    table = train_table(context, one.found, floor_of_best(context, one.found))
    return [*((sorted(e.keys), e.gain, e.error, [s.tolist() for s in e.model.sizes()]) for e in one.found),
            (family.rows.core, family.unit, family.noise.noise.torque.tolist(), table.values.tolist()),
            *(([e.key for e in m.effects], m.state.beta.tolist()) for m in family.models)]


def test_no_test_run_is_looked_at_before_the_search_has_ended() -> None:
    """Test runs whose readings are of another motion change nothing of what is found, and everything of the verdict."""
    first = searched(drag=DRAG)
    split = first.context.split
    tests = {split.names[k] for k in split.test}
    runs = [replace(run, columns=dict(run.columns) | {"q1_rad": np.sin(3.0 * run.time_s)}) if run.name in tests else run
            for run in pendulum_runs(4, drag=DRAG)]
    other = search_runs(runs)
    assert len(tests) == 1 and other.context.split.test == split.test
    assert what_was_found(first) == what_was_found(other)
    verdicts = []
    for one in (first, other):
        table = measure_first(one.family, default_rng(1))
        verdicts.append(decide(table, one.family.rows, MATERIAL))
    assert [v.verdict for v in verdicts] == ["named", "unexplained"] and verdicts[1].why == UNCHANGED


def test_both_hidden_causes_are_the_answer_and_each_is_needed() -> None:
    one = searched(drag=DRAG, spring=SPRING)
    rows, models = one.family.rows, one.family.models
    assert rows.answer is not None and rows.second is None and rows.minor is None and not rows.hidden
    assert rows.answer.best[0].keys == {"quadratic_drag@1", "joint_stiffness@1"}
    assert [{e.key for e in models[k].effects} for k in rows.answer.without] == [
        rows.answer.best[0].keys - {e.key} for e in rows.answer.best[0].model.effects]
    assert models[0] is one.context.nominal and all(m.split is one.context.split for m in models[1:])
    table = measure_first(one.family, default_rng(1))
    found = decide(table, rows, MATERIAL)
    assert found.verdict == "named" and found.answer is rows.answer and not found.open
    assert table.error(0) > 10.0 and table.error(rows.answer.row) < 1.2
    assert min(table.error(k) for k in rows.answer.without) > 2.0
    assert probability_of(found, table, rows, table, MATERIAL) == pytest.approx(1.0)


def test_the_gain_is_measured_at_each_horizon_that_decides() -> None:
    one = searched(drag=DRAG)
    table, row = measure_first(one.family, default_rng(1)), one.family.rows.answer.row
    found = gains_by_horizon(table, row)
    assert tuple(gain.horizon_s for gain in found) == DECIDING_S
    for gain in found:
        squares = table.values[[0, row]][:, :, [h == gain.horizon_s for _, h in table.columns]].mean(axis=(1, 2))
        assert gain.ratio == pytest.approx(np.sqrt(squares[1] / squares[0]))
        assert gain.ci95[0] <= gain.ratio <= gain.ci95[1] < 0.3
    assert {(gain.ratio, *gain.ci95) for gain in gains_by_horizon(table, 0)} == {(1.0, 1.0, 1.0)}


def test_a_gain_is_stated_of_an_answer_alone() -> None:
    """Of a cause that hardly changes the simulation no extended model is told, so no errors of one."""
    one = searched(drag=DRAG)
    table = measure_first(one.family, default_rng(1))
    found = decide(table, one.family.rows, MATERIAL)
    answers: list[tuple[Verdict, list[float]]] = [("named", list(DECIDING_S)), ("none", [])]
    for verdict, horizons in answers:
        told = describe(one.context, base(one.context.nominal, {}, None), one.family,
                        replace(found, verdict=verdict), table, table, (), None, default_rng(0))
        assert (told.verdict, [gain.horizon_s for gain in told.by_horizon]) == (verdict, horizons)


def test_each_run_is_a_test_run_once_with_every_model_fitted_anew() -> None:
    one = searched(drag=DRAG, spring=SPRING)
    first = measure_first(one.family, default_rng(1))
    every = measure_all(one.family, first, default_rng(2), MATERIAL)
    assert every is not None
    table, rotations = every
    assert sorted(name for r in rotations for name in r.runs) == ["r0", "r1", "r2", "r3"] and rotations[0].falls
    assert rotations[0].runs == tuple(one.context.split.names[k] for k in one.context.split.test)
    drags = [r.sizes["quadratic_drag@1.drag"] for r in rotations]
    assert drags == pytest.approx([DRAG] * 4, rel=0.05) and len(set(drags)) == 4
    assert table.agreement.shape == (len(one.family.models), 4) and set(table.runs.tolist()) == {0, 1, 2, 3}
    blocks = first.values.shape[1]
    assert np.array_equal(table.values[:, :blocks], first.values)
    assert np.isfinite(table.values[list(one.family.rows.core)]).all()
    again = decide(table, one.family.rows, MATERIAL)
    assert again.verdict == "named" and again.answer is one.family.rows.answer


def test_a_model_that_cannot_be_fitted_again_leaves_the_answer_to_the_first_test_runs() -> None:
    one = searched(drag=DRAG)
    first, row = measure_first(one.family, default_rng(1)), one.family.rows.answer.row
    model = one.family.models[row]
    lost = replace(model, state=replace(model.state, beta=np.full_like(model.state.beta, np.nan)))
    models = tuple(lost if k == row else m for k, m in enumerate(one.family.models))
    assert measure_all(replace(one.family, models=models), first, default_rng(2), MATERIAL) is None


def test_where_the_answer_cannot_be_simulated_the_nominal_model_is_the_unit() -> None:
    """... and where neither can, that is said."""
    one = searched(drag=DRAG)
    row = one.family.rows.answer.row
    model = one.family.models[row]
    wild = model.state.beta.copy()
    wild[2] = -5.0  # friction that drives
    models = list(one.family.models)
    models[row] = replace(model, state=replace(model.state, beta=wild))
    family = replace(one.family, models=tuple(models))
    table = measure_first(family, default_rng(1))
    assert table.error(0) > 10.0 and decide(table, family.rows, MATERIAL).verdict == "unexplained"
    models[0] = replace(models[0], state=replace(models[0].state, beta=wild[:4]))
    with pytest.raises(FitError):
        measure_first(replace(family, models=tuple(models)), default_rng(1))


def test_the_model_with_the_cause_predicts_the_runs_left_out_better() -> None:
    one = searched(drag=DRAG)
    answer, nominal = one.found[0].model, one.context.nominal
    assert surely_errs_less(answer, nominal, default_rng(0)) and not surely_errs_less(nominal, answer, default_rng(0))
    assert not surely_errs_less(answer, answer, default_rng(0))


@pytest.mark.parametrize("fitted, found, stays", [
    (SMOOTHING, SMOOTHING, True), (SMOOTHING, 40.0 * SMOOTHING, True), (40.0 * SMOOTHING, SMOOTHING, False)])
def test_another_smoothing_velocity_is_refused_where_it_predicts_the_runs_left_out_worse(
        monkeypatch: pytest.MonkeyPatch, fitted: float, found: float, stays: bool) -> None:
    """Friction without a step, as with 2 rad/s, is no friction of this pendulum."""
    one = search_runs(pendulum_runs(4, drag=DRAG), fitted)
    monkeypatch.setattr(procedure, "likeliest_smoothing_velocity", lambda *_: joint1(velocity_scale=found))
    nominal = with_smoothing_velocity(Begun(one.context, one.tests, True, one.generic), mechanism())
    assert (nominal is None) is stays
    if nominal is not None:
        assert nominal.split.mechanism.velocity_scales == pytest.approx([found]) and not nominal.effects
