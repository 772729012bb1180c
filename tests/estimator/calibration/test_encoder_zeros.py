"""Encoders' zeros that differ from run to run, on MuJoCo's leg."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from pytest import approx, fixture, raises

from daq import Dataset
from daq.runs import write_csv
from estimator import FitError, FitOptions
from estimator.calibration import differing_text, find_differing, find_zeros, subtract
from estimator.model import leg2
from tests.support.mujoco_leg import Leg, record
from tests.support.shell import Shell, document

LEG = Leg()
SHIFTS = np.array([[0.06, -0.09], [-0.02, 0.03], [0.01, 0.05], [-0.03, -0.01]])
"""What the encoders of pivot and knee read too much in each run [rad]"""
RIG = """[mechanism]
model = "leg2"
actuated = [2]
[terms]
{terms}
[sampling]
rate_hz = 100.0
"""


def shifted(data: Dataset, by: np.ndarray) -> Dataset:
    return replace(data, columns={**data.columns, **{f"q{j + 1}_rad": data[f"q{j + 1}_rad"] + by[j] for j in range(2)}})


@fixture(scope="module")
def plain() -> list[Dataset]:
    return [record(LEG, np.random.default_rng(800 + k), seconds=12.0, name=f"r{k}") for k in range(4)]


@fixture(scope="module")
def runs(plain: list[Dataset]) -> list[Dataset]:
    return [shifted(data, by) for data, by in zip(plain, SHIFTS)]


def test_zeros_are_found_together_with_the_parameters(runs: list[Dataset], plain: list[Dataset]) -> None:
    mechanism, options = leg2(), FitOptions(sensors="encoder")
    found = find_zeros(runs, mechanism, options, (0, 1))
    wanted = SHIFTS - SHIFTS.mean(axis=0)
    assert found.values == approx(wanted, abs=4e-3)
    assert np.all(found.std < 4e-3) and np.all(found.std > 0.0)
    back = subtract(runs, mechanism, found)
    for data, before in zip(back, plain):
        for j in range(2):
            assert data[f"q{j + 1}_rad"] - before[f"q{j + 1}_rad"] == approx(SHIFTS[:, j].mean(), abs=4e-3)


def test_a_known_model_places_a_single_run(runs: list[Dataset]) -> None:
    found = find_zeros(runs[:1], leg2(), FitOptions(sensors="encoder"), (0, 1), LEG.beta())
    assert found.values[0] == approx(SHIFTS[0], abs=4e-3)


def test_the_knee_alone_where_the_imu_gives_the_pivot(runs: list[Dataset]) -> None:
    mechanism, options = leg2(lever_arm=LEG.lever), FitOptions(sensors="imu")
    found = find_zeros(runs, mechanism, options, (1,))
    assert found.values[:, 0] == approx(SHIFTS[:, 1] - SHIFTS[:, 1].mean(), abs=4e-3)
    with raises(FitError, match="joint 1, which has no encoder on the imu path"):
        find_zeros(runs, mechanism, options, (0,))


def test_one_run_says_nothing_of_differences(runs: list[Dataset]) -> None:
    assert not find_zeros(runs[:1], leg2(), FitOptions(sensors="encoder"), (0, 1)).values.any()


def test_without_motion_there_is_nothing_to_find() -> None:
    rest = record(LEG, np.random.default_rng(1), seconds=4.0, tau=np.zeros(400), name="rest")
    with raises(FitError, match="zeros are not to be found"):
        find_zeros([rest, rest], leg2(), FitOptions(sensors="encoder"), (0, 1))


def test_zeros_that_differ_are_noticed_and_others_are_not(runs: list[Dataset], plain: list[Dataset]) -> None:
    for mechanism, options, joints in ((leg2(), FitOptions(sensors="encoder"), (0, 1)),
                                       (leg2(lever_arm=LEG.lever), FitOptions(sensors="imu"), (1,))):
        found = find_differing(runs, mechanism, options)
        assert found is not None and found.joints == joints
        assert found.spread == approx(np.std(SHIFTS[:, list(joints)], axis=0, ddof=1), rel=0.15)
        assert f"encoder_zero = [{', '.join(str(j + 1) for j in joints)}]" in differing_text(found)
        assert find_differing(plain, mechanism, options) is None
        assert find_differing(runs[:3], mechanism, options) is None


def test_only_a_zero_that_differs_is_declared(plain: list[Dataset]) -> None:
    mechanism, options = leg2(), FitOptions(sensors="encoder")
    for moved in (0, 1):
        runs = [shifted(data, by * np.eye(2)[moved]) for data, by in zip(plain, SHIFTS)]
        found = find_differing(runs, mechanism, options)
        assert found.joints == (moved,)
        assert found.spread == approx(np.std(SHIFTS[:, [moved]], axis=0, ddof=1), rel=0.15)


def test_the_commands_take_declared_zeros_off(runs: list[Dataset], tmp_path: Path,
                                              shell: Shell) -> None:
    files = [tmp_path / f"{data.name}.csv" for data in runs]
    for data, file in zip(runs, files):
        write_csv(data, file)
    errors = {}
    for name, terms in (("plain", "encoder_zero = []"), ("zero", "encoder_zero = [1, 2]\ntorque_offset = []")):
        rig, model = tmp_path / f"{name}.toml", tmp_path / f"{name}.json"
        rig.write_text(RIG.format(terms=terms))
        shell("fit", *files[:3], "--rig", rig, "--sensors encoder --model-out", model)
        said = shell.out
        assert ("encoders' zeros, another in every run, are taken off" in said) == (name == "zero")
        assert "encoder_offset@1 explains most of it" not in said  # what all runs have in common is off, too
        (found,) = document("validate", model, files[3], "--rig", rig, "--sensors encoder")["runs"]
        errors[name] = found["rmse"]["q2_rad"]
    assert errors["zero"] < 0.8 * errors["plain"]


def test_a_joint_that_is_not_there_is_refused(tmp_path: Path, shell: Shell) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.format(terms="encoder_zero = [3]"))
    assert "terms.encoder_zero names joint 3, leg2 has 2" in shell.fails("fit r.csv --rig", rig)
