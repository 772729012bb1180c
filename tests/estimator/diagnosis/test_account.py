"""What is told of a decision: shares of the error, sizes that a minor cause moves, sensors that show nothing."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.random import default_rng
from pytest import MonkeyPatch, approx, mark

from estimator import Diagnosis
from estimator.diagnosis import account
from estimator.diagnosis.account import causes_of, compared, finding, undecided, with_blind_sensors, with_minor
from estimator.diagnosis.error_budget import budget
from estimator.diagnosis.explanation import Explanation
from estimator.diagnosis.family import FittedFamily
from estimator.diagnosis.verdict import Answer, Family, Hidden
from estimator.effects import TorqueDelay, battery
from estimator.effects.accelerometer_bias import AccelerometerBias
from estimator.effects.joint_stiffness import JointStiffness
from estimator.model import leg2
from tests.support.stated_fits import NOTHING_LEFT, Named, explained, fitted
from tests.support.stated_tables import table_of


def test_shares_of_the_budget_add_up() -> None:
    table = table_of(5.0, 1.5, 3.0, 4.0)  # nominal, both causes, less the first, less the second
    both = explained(900.0, Named("torque_delay"), Named("backlash", 1))
    rows = budget(table, Answer((both,), 1, (2, 3), 1))
    assert [(r.what, r.effect, r.joint) for r in rows] == [
        ("nominal", None, None), ("cause", "torque_delay", None), ("cause", "backlash", 2), ("remainder", None, None),
        ("noise", None, None)]
    share = {r.what + (r.effect or ""): r.share for r in rows}
    assert share["nominal"] == 1.0
    assert share["causetorque_delay"] + share["causebacklash"] + share["remainder"] == approx(1.0)
    assert share["remainder"] == approx((1.5**2 - 1.0) / (5.0**2 - 1.0))
    # without the first 9 - 2.25 of error come back, without the second 16 - 2.25
    assert share["causebacklash"] / share["causetorque_delay"] == approx((16 - 2.25) / (9 - 2.25))
    assert share["noise"] == approx(1.0 / 24.0)
    assert all(r.ci95[0] <= r.share + 1e-9 and r.share <= r.ci95[1] + 1e-9 for r in rows)
    assert [(r.what, r.share) for r in budget(table, None)][1] == ("remainder", 1.0)


@mark.parametrize("errors", [(5.0, 1.5, 3.0, 4.0), (5.0, 0.9, 3.0, 4.0), (1.03, 1.01, 1.02, 1.02),
                                    (1.5, 9.0, 3.0, 4.0)])
def test_the_shares_of_the_whole_error_are_never_above_it(errors: tuple[float, ...]) -> None:
    """Noise alone was 1659 % of an excess over noise that was small, and a cause that raises the error -5180 %."""
    both = explained(900.0, Named("torque_delay"), Named("backlash", 1))
    _, *rows = budget(table_of(*errors), Answer((both,), 1, (2, 3), 1))
    assert sum(row.of_error for row in rows) == approx(1.0)
    assert all(0.0 <= x <= 1.0 for row in rows for x in (row.of_error, *row.of_error_ci95))
    causes = sum(row.of_error for row in rows if row.what == "cause")
    assert causes == approx(max(1.0 - (errors[1] / errors[0])**2, 0.0))


def test_no_budget_is_made_of_noise() -> None:
    assert budget(table_of(0.98, 0.97), Answer((explained(9.0, "drag"),), 1, (), 1)) == ()


def test_sets_of_listed_effects_alone_are_compared() -> None:
    """Neither generic terms nor fits under another noise, and of two fits of one set the better."""
    models = [fitted(0.0), fitted(9.0, "drag"), fitted(9.0, "drag"), fitted(9.0, "play", "drag"), fitted(9.0, "drag"),
              SimpleNamespace(effects=(Named("drag"), battery(leg2(), False)[0]))]
    family = cast(FittedFamily, SimpleNamespace(rows=Family(0, hidden=(Hidden(0, 4, "", True),)), models=models))
    found = compared(family, table_of(9.0, 1.4, 1.3, 1.1, 0.2, 0.1))
    assert [keys for keys, _ in found] == [("drag", "play"), ("drag",)]
    assert [error for _, error in found] == approx([1.1, 1.3])


def test_none_is_no_promise_where_noise_moves_free_runs_as_far_as_the_motion() -> None:
    """A cart without a spring drifts by its torque's noise alone: nothing was found where free runs erred -553 %."""
    columns = (("q1_m", 0.1), ("q1_m", 1.0), ("q1_m", np.inf), ("gyro_radps", np.inf))
    table = replace(table_of(1.0), columns=columns, floor=np.array([0.1, 0.6, 4.0, 0.4]), bound=np.ones(4))
    warned = with_blind_sensors(Diagnosis("none", "", warnings=("first",)), table).warnings
    assert warned[0] == "first" and len(warned) == 2
    assert "60 % of the variance of q1_m in free runs over 1 s" in warned[1]
    late = replace(table, floor=np.array([0.1, 0.2, 0.9, 0.4]))
    assert "90 % of the variance of q1_m in free runs over whole runs" in with_blind_sensors(
        Diagnosis("none", ""), late).warnings[0]
    quiet = replace(table, floor=np.full(4, 0.1))
    assert with_blind_sensors(Diagnosis("none", ""), quiet).warnings == ()


def told(*sizes: tuple[Any, float, float]) -> Explanation:
    """Effects with the value and the standard deviation of their first size; the second, if any, is 0."""
    values = [np.pad([value], (0, e.count - 1)) for e, value, _ in sizes]
    spread = np.concatenate([np.pad([std], (0, e.count - 1)) for e, _, std in sizes])
    ends = np.cumsum([v.size for v in values])
    model: Any = SimpleNamespace(
        effects=tuple(e for e, *_ in sizes), sizes=lambda: values, taken_of=lambda effect: np.zeros(effect.count),
        places=lambda: [slice(end - v.size, end) for v, end in zip(values, ends)],
        state=SimpleNamespace(covariance=np.diag(spread**2), beta=np.concatenate(values)),
        problem=SimpleNamespace(mechanism=SimpleNamespace(unit=str)),
        split=SimpleNamespace(delays_s=(), mechanism=SimpleNamespace(p=0), tolerances=None))
    known = np.ones(spread.size, dtype=bool)
    return Explanation(model, 900.0, replace(NOTHING_LEFT, freedom=1e6), inflation=np.ones(spread.size),
                       determined=known)


def test_sizes_are_told_as_they_are_together_with_a_minor_cause() -> None:
    """A spring of 0.35 N m/rad with a torque 6 ms late: 0.394 [0.387, 0.401] without the delay, 0.370 with it."""
    spring, delay = JointStiffness(1), TorqueDelay()
    alone = told((spring, 0.394, 0.0035))
    both = replace(told((spring, 0.370, 0.0025), (delay, 0.005, 1.5e-4)), gain=4230.0)
    found = with_minor(alone, both)
    assert found.gain == alone.gain and found.beyond == alone.keys and found.within == {delay.key}
    assert [(c.effect, c.size[0].value) for c in causes_of(found, 1e-9, Diagnosis("named", ""))] == [
        ("joint_stiffness", 0.370), ("torque_delay", 0.005)]


def test_each_of_the_causes_that_are_not_told_apart_is_told(monkeypatch: MonkeyPatch) -> None:
    """Of one whose intervals hold zero nothing was told: "... or ."."""
    monkeypatch.setattr(account, "with_gain", lambda found, *_: found)
    spring, delay = told((JointStiffness(1), 0.4, 0.01)), told((TorqueDelay(), 0.001, 0.001))
    either = [one.as_told() for one in (spring, delay)]
    assert not either[1].beyond
    nothing: Any = None
    found = finding(Diagnosis("named", ""), nothing, either, 1e-9, default_rng(1), False, nothing)
    assert found.verdict == "one_of" and [c.effect for c in found.causes] == ["joint_stiffness", "torque_delay"]
    assert "torque delay" in found.sentence and found.immaterial == ()


def test_whether_a_cause_is_a_fault_is_decided_by_the_sizes_that_are_told() -> None:
    """A bias of 0.21 m/s2 at the optimum was a fault, and told as 0.094: less than twice its tolerance of 0.1."""
    one = told((AccelerometerBias(), 0.21, 0.001))
    model: Any = one.model
    model.split.tolerances = {}
    model.problem = SimpleNamespace(mechanism=leg2(), n=2, torque=np.ones((9, 2)))
    for size, within in ((0.19, one.keys), (0.21, frozenset())):
        vars(one).update(estimate=(np.array([size, 0.0]), np.eye(2)), half_widths=np.full(2, 1e-3))
        assert one.as_told().within == within


def test_a_leg_that_no_model_simulates_is_unexplained_and_not_undiagnosed() -> None:
    found = undecided(Diagnosis("none", ""), "every simulation diverges")
    assert found.verdict == "unexplained" and "every simulation diverges" in found.sentence and not found.causes
    assert found.next_experiment
