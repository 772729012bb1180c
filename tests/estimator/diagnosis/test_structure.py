"""A diagnosis offers a structure only where its verdict leaves something, and on top of the model that it saves."""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from pytest import MonkeyPatch, fixture, mark

from estimator import Diagnosis, FitError, FitOptions, Verdict
from estimator.diagnosis import structure
from estimator.diagnosis.account import counted_as_noise
from estimator.diagnosis.data_split import split_runs
from estimator.diagnosis.structure import with_structure
from estimator.effects.joint_stiffness import JointStiffness
from estimator.model import leg2
from estimator.prediction import FittedModel, RunSignals, Structure
from tests.support.learnt import hidden_magnet
from tests.support.mujoco_leg import Leg, record

BETA = Leg().beta()
NOMINAL = dict(zip(leg2(lever_arm=0.2).names, BETA, strict=True))


@fixture(scope="module")
def nominal() -> Any:
    """As much of a fitted model as a structure needs."""
    data = [record(Leg(), np.random.default_rng(k), seconds=3.0, name=f"r{k}") for k in range(4)]
    split = split_runs(data, leg2(lever_arm=0.2), FitOptions(sensors="imu", hold="linear"), 50.0, 1)
    reach = np.array([[-1.0, 1.0], [-2.0, 2.0]])
    return SimpleNamespace(split=split, fitted=FittedModel(split.mechanism, "linear", BETA, angle_range=reach,
                                                           gear_ratio=50.0))


@fixture
def asked(monkeypatch: MonkeyPatch) -> list[FittedModel]:
    """Models whose residual was learnt from; the answer is that of a leg with a magnet."""
    models: list[FittedModel] = []

    def learn(model: FittedModel, runs: Sequence[RunSignals], options: FitOptions, workers: int) -> Structure:
        models.append(model)
        assert len(runs) == 4
        return hidden_magnet()

    learning(learn, monkeypatch)
    return models


def learning(learn: Callable[..., Structure], monkeypatch: MonkeyPatch) -> None:
    """`learn` stands for what takes minutes and has tests of its own."""
    monkeypatch.setattr(structure, "find_structure", learn)


@mark.parametrize("verdict", ["none", "named", "one_of", "fit_failed"])
def test_verdicts_that_leave_nothing_have_none(verdict: Verdict, nominal: Any, asked: list[FittedModel]) -> None:
    found = Diagnosis(verdict, "")
    assert with_structure(found, nominal) is found and not asked


def test_it_is_learnt_on_top_of_the_model_that_is_saved(nominal: Any, asked: list[FittedModel]) -> None:
    assert with_structure(Diagnosis("unexplained", "", nominal=NOMINAL), nominal).structure is hidden_magnet()
    spring = JointStiffness(1)
    extended = np.append(1.1 * BETA, [0.3, 0.0])
    partial = Diagnosis("partial", "", effects=((spring, extended[9:]),), extended_beta=extended)
    assert with_structure(partial, nominal).structure is hidden_magnet()
    plain, with_spring = asked
    assert plain.effects == () and np.array_equal(plain.parameters, BETA)
    assert with_spring.effects == (spring,) and np.array_equal(with_spring.parameters, extended)


def test_it_is_offered_only_if_it_is_material(nominal: Any, asked: list[FittedModel]) -> None:
    found = with_structure(Diagnosis("unexplained", "", nominal=NOMINAL, material=0.95), nominal)
    (told,) = found.warnings
    assert found.structure is None and "not offered" in told
    assert f"remove {100.0 * hidden_magnet().removed:.0f} % [" in told


def test_a_torque_that_is_learnt_is_no_noise(nominal: Any, asked: list[FittedModel]) -> None:
    """One page said of a magnet that it does not depend on the state, and drew it over the angle."""
    joints = {(law.joint or 0) + 1 for law in hidden_magnet().laws}
    told = tuple(f"an unmeasured torque of 0.02 N m acts {counted_as_noise(j)}" for j in (1, 2, 3))
    found = with_structure(Diagnosis("unexplained", "", nominal=NOMINAL, warnings=told), nominal)
    assert found.warnings == tuple(w for j, w in enumerate(told, 1) if j not in joints)


def test_runs_that_teach_nothing_leave_the_diagnosis(nominal: Any, monkeypatch: MonkeyPatch) -> None:
    def fails(*_: object) -> Structure:
        raise FitError("no")

    learning(fails, monkeypatch)
    found = Diagnosis("unexplained", "", nominal=NOMINAL)
    assert with_structure(found, nominal) is found
