"""Sets of effects whose sizes the runs do not determine, on a simulated leg."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng

from daq import FloatArray
from estimator import Diagnosis, Effect, FitOptions
from estimator.diagnosis.account import finding
from estimator.diagnosis.context import DiagnosisContext, assess, scored
from estimator.diagnosis.data_split import split_runs
from estimator.diagnosis.explanation import Explanation, admissible, indistinguishable_set, undetermined
from estimator.diagnosis.model import nominal_model
from estimator.diagnosis.search import exchanged, fit_sets, reduced
from estimator.effects import Points, View
from estimator.effects.joint_stiffness import JointStiffness
from estimator.effects.torque_offset import TorqueOffset
from estimator.likelihood import Candidate
from estimator.model import leg2
from estimator.prediction import white_noise
from estimator.score import Score, determined
from tests.support.mujoco_leg import Leg, record


class Hose(JointStiffness):
    """A spring under another name, of half the stiffness for its size."""

    name = "hose"

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        return super().law(at, np.array([0.5 * size[0], size[1]]), view)


SPRING, HOSE, OFFSET = JointStiffness(1), Hose(1), TorqueOffset()


@pytest.fixture(scope="module")
def sprung() -> DiagnosisContext:
    """The nominal fit of runs with a spring of 0.4 N m/rad at the knee."""
    leg = Leg()
    runs = [record(leg, default_rng(640 + k), seconds=10.0, name=f"r{k + 1}") for k in range(4)]
    runs = [replace(run, columns=dict(run.columns) | {"tau2_nm": run["tau2_nm"] + 0.4 * run["q2_rad"] - 0.05})
            for run in runs]
    split = split_runs(runs, leg2(lever_arm=leg.lever), FitOptions(sensors="imu"))
    candidates = [Candidate(e) for e in (SPRING, HOSE, OFFSET)]
    return scored(nominal_model(split), candidates, len(candidates), default_rng(1), lambda *_: None)[0]


def fitted(context: DiagnosisContext, *effects: Effect) -> Explanation:
    """These effects, fitted together."""
    (found,) = assess(context, fit_sets(context, [(context.nominal, [(e, np.zeros(e.count)) for e in effects])]))
    return found


def test_an_effect_whose_only_size_another_one_replaces_is_no_answer(sprung: DiagnosisContext) -> None:
    alone, both = fitted(sprung, SPRING), fitted(sprung, SPRING, OFFSET)
    assert admissible(alone) and not any(undetermined(alone))
    assert alone.model.sizes()[0][0] == pytest.approx(0.4, rel=0.05)
    assert not admissible(both) and undetermined(both) == [False, True]  # the preload replaces the offset
    assert {e.keys for e in reduced(sprung, [both])} == {alone.keys}


def test_effects_that_replace_each_other_are_alternatives(sprung: DiagnosisContext) -> None:
    both = fitted(sprung, SPRING, HOSE)
    assert undetermined(both) == [True, True] and not admissible(both)
    alone = reduced(sprung, [both])
    assert {e.keys for e in alone} == {frozenset({SPRING.key}), frozenset({HOSE.key})}
    assert all(admissible(e) for e in alone)
    gain = alone[0].gain
    assert alone[1].gain == pytest.approx(gain, rel=1e-3)  # a bounded number of steps finds no more digits
    weighed = indistinguishable_set([replace(e, gain=gain, by_run=np.full(4, -gain / 4.0)) for e in alone])
    assert len(weighed) == 2
    nominal = sprung.nominal
    plain = Diagnosis("none", "", nominal=dict(zip(nominal.split.mechanism.names, nominal.state.beta)))
    told = finding(plain, nominal, weighed, 0.001, sprung.rng, False, white_noise(nominal.state.noise))
    assert told.verdict == "one_of" and {c.effect for c in told.causes} == {SPRING.name, HOSE.name}
    assert told.sentence.startswith("One of these causes") and "To tell them apart" in told.next_experiment


def test_an_effect_is_exchanged_for_one_that_replaces_it(sprung: DiagnosisContext) -> None:
    context, tests = scored(nominal_model(sprung.split), sprung.candidates, sprung.named, default_rng(1),
                            lambda *_: None)
    found = exchanged(context, tests, [fitted(context, SPRING)])
    assert HOSE.key in {key for e in found for key in e.keys} and all(SPRING.key not in e.keys for e in found)
    assert all(len(e.keys) == 1 for e in found)


def test_sizes_are_determined_where_the_other_columns_leave_information() -> None:
    rng, runs = default_rng(3), []
    for _ in range(4):
        rows = rng.normal(size=(50, 4))
        rows[:, 1] = rows[:, 0] + 1e-4 * rows[:, 1]  # a share of 1e-8 is its own
        rows[:, 3] = rows[:, 2] + 0.1 * rows[:, 3]  # a share of 0.01
        runs.append(Score(np.zeros(4), rows.T @ rows))
    assert determined(runs, np.ones(4, dtype=bool)).tolist() == [False, False, True, True]
    assert determined(runs, np.array([True, False, True, True])).tolist() == [True, False, True, True]
