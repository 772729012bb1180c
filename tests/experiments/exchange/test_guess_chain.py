"""The guess for a chain of joints: units, signs, absolute angles, which joint a torque drives; by another engine."""

from pathlib import Path

import numpy as np
import pytest

from experiments.cli import main
from experiments.exchange.column_map import apply_map, load_map
from experiments.exchange.guess_chain import of_joints
from experiments.exchange.reading import read_imported
from tests.support.imported_files import guess, table
from tests.support.mujoco_tree import disturbed, move, random_tree, torques
from tests.support.shell import Shell, typed


def record(path: Path, names: list[str], *, links: int = 3, unit: float = 1.0, signs: tuple[int, ...] = (1, 1, 1),
           works: tuple[int, ...] = (1, 1, 1), absolute: bool = False, tilt: float = 0.0, seed: int = 3) -> Path:
    """A chain that MuJoCo moves for 12 s at 100 Hz, all joints driven, as another program logs it."""
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, tuple(range(-1, links - 1)))
    run = disturbed(move(tree, torques(tree, rng, 12.0, 100.0, 0.5, range(links)), 100.0), range(links), 100.0, rng)
    q = np.stack([run[f"q{k + 1}_rad"] for k in range(links)], axis=1) * np.array(signs[:links])
    q = (np.cumsum(q, axis=1) if absolute else q) + np.eye(links)[0] * tilt
    tau = np.stack([run[f"tau{k + 1}_nm"] for k in range(links)], axis=1) * np.array(works[:links])
    return table(path, dict(zip(["time", *names], [np.arange(len(run)) / 100.0, *(q / unit).T, *tau.T])), 9)


NAMED = ["hip_pos", "knee_pos", "ankle_pos", "hip_effort", "knee_effort", "ankle_effort"]
NUMBERED = ["q1", "q2", "q3", "tau1", "tau2", "tau3"]


@pytest.mark.parametrize("names, unit, written, signs, works", [
    (NAMED, 1.0, "", (1, 1, 1), (1, 1, 1)),
    (NUMBERED, np.pi / 180, "deg", (1, -1, 1), (1, 1, -1)),
    (NUMBERED, 2 * np.pi, "turn", (1, -1, -1), (-1, -1, -1)),
])
def test_units_and_signs_of_a_chain(names: list[str], unit: float, written: str, signs: tuple[int, ...],
                                    works: tuple[int, ...], tmp_path: Path) -> None:
    found = guess(record(tmp_path / "x.csv", names, unit=unit, signs=signs, works=works))
    for k in range(3):
        angle, torque = found[f"q{k + 1}_rad"], found[f"tau{k + 1}_nm"]
        assert (angle.name, angle.unit, angle.sign) == (names[k], written, signs[k])
        assert (torque.name, torque.sign) == (names[3 + k], works[k])


def test_absolute_angles_become_relative_ones(tmp_path: Path) -> None:
    file = record(tmp_path / "x.csv", NUMBERED, absolute=True)
    found = guess(file)
    assert [(found[f"q{k}_rad"].name, found[f"q{k}_rad"].minus) for k in (1, 2, 3)] == [
        ("q1", ""), ("q2", "q1"), ("q3", "q2")]
    relative = np.loadtxt(record(tmp_path / "y.csv", NUMBERED), delimiter=",", skiprows=1)
    run = apply_map(read_imported(file), found)
    for k in (1, 2, 3):
        kept = np.isfinite(run[f"q{k}_rad"])
        assert kept.mean() > 0.95
        np.testing.assert_allclose(run[f"q{k}_rad"][kept], relative[kept, k], atol=1e-6)


def test_commands_and_sums_of_angles_are_no_joints(tmp_path: Path) -> None:
    """What brachiating robots log: a second arm's absolute angle, an IMU's mean angle, torques before their limit."""
    names = ["arm1_pos", "tail_pos", "phi_pos", "tail_tau", "phi_tau"]
    file = record(tmp_path / "x.csv", [*names[:3], "arm1_tau", *names[3:]])
    t, q1, q2, q3, _, tau2, tau3 = np.loadtxt(file, delimiter=",", skiprows=1).T
    sums = {"arm2_pos": q2 + q3, "raw_imu_pos": 0.99 * q1 + 0.01 * np.cos(t), "tail_clipped_tau": 0.9 * tau2}
    table(file, dict(zip(["time", *names], [t, q1, q2, q3, tau2, tau3])) | sums, 15)
    main(["import", str(file), "--guess", "--map", str(tmp_path / "c.toml")])
    found = load_map(tmp_path / "c.toml")
    assert sorted(found) == ["q1_rad", "q2_rad", "q3_rad", "tau2_nm", "tau3_nm", "time_s"]
    assert [found[name].name for name in ("tau2_nm", "tau3_nm")] == ["tail_tau", "phi_tau"]
    assert not {"arm2_pos", "raw_imu_pos"} & {column.name for column in found.values()}


def test_two_driven_joints_go_to_a_fit(tmp_path: Path) -> None:
    file = record(tmp_path / "x.csv", ["q1", "q2", "tau1", "tau2"], links=2, unit=np.pi / 180)
    (tmp_path / "rig.toml").write_text('[mechanism]\nmodel = "leg2"\nactuated = [1, 2]\n')
    guess(file)
    typed("import", file, "--map", tmp_path / "x.toml", "--out", tmp_path / "runs")
    typed("fit", tmp_path / "runs" / "x.csv", "--rig", tmp_path / "rig.toml")


def test_a_zero_that_does_not_hang_is_reported(tmp_path: Path, shell: Shell) -> None:
    guess(record(tmp_path / "x.csv", NUMBERED, tilt=1.5708))
    assert "joint 1 hangs at 1.57 rad, not at 0: set offset = -1.57" in shell.err


def test_torques_of_another_machine_are_not_explained(tmp_path: Path, shell: Shell) -> None:
    file = record(tmp_path / "x.csv", NUMBERED)
    rows = np.loadtxt(file, delimiter=",", skiprows=1)
    rows[:, 4:] = np.random.default_rng(2).normal(size=(len(rows), 3)).cumsum(axis=0)
    table(file, dict(zip(["time", *NUMBERED], rows.T)))
    shell("import", file, "--guess --map", tmp_path / "c.toml", status=1)
    assert "explain the torques" in shell.err
    found = load_map(tmp_path / "c.toml")
    assert all(found[f"q{k}_rad"].name == f"q{k}" and not found[f"q{k}_rad"].unit for k in (1, 2, 3))


@pytest.mark.parametrize("angles, torques_, joints", [
    (["shoulder_meas_pos", "elbow_meas_pos"], ["elbow_meas_effort", "shoulder_meas_effort"], [1, 0]),
    (["q1", "q2", "q3"], ["tau2", "tau3"], [1, 2]),
    (["position[0]", "position[1]"], ["effort[0]", "effort[1]"], [0, 1]),
])
def test_a_torque_s_joint_shows_in_its_name(angles: list[str], torques_: list[str], joints: list[int]) -> None:
    assert of_joints(angles, torques_) == dict(zip(joints, torques_))
