"""Recordings in the layouts of other projects, each written as its program writes it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq import Dataset, InputError
from daq.runs import read_csv
from experiments.exchange import apply_map, guess_map, read_imported, runs_in
from tests.support.imported_files import table
from tests.support.public_layouts import SO101, bam, dynamixel, feetech, lerobot, trajectory_bag
from tests.support.servo_joint import servo_run
from tests.support.shell import Shell
from tests.support.tree_files import npz

COUNT = 2.0 * np.pi / 4096
DEGREE = np.pi / 180.0


def arm(seed: int, seconds: float = 6.0, scale: float = 1.0) -> list[Dataset]:
    runs = [servo_run(seed=10 * seed + k, seconds=seconds, rate_hz=25.0) for k in range(6)]
    return [replace(run, columns={name: scale * values for name, values in run.columns.items()}) for run in runs]


@pytest.mark.parametrize("joint", ["3", "dof_pos[3]"])
def test_pace_holds_matrices_of_angles_and_commands_in_rad(joint: str, tmp_path: Path) -> None:
    run, other = servo_run(), servo_run(seed=2)
    q, c = ([other[name], other[name] - 0.2, run[name]] for name in ("q1_rad", "q1_cmd_rad"))
    npz({"time": run.time_s.astype("f4"), "dof_pos": np.column_stack(q).astype("f4"),
         "des_dof_pos": np.column_stack(c).astype("f4")}, tmp_path / "chirp_data.npz")
    found = guess_map(read_imported(tmp_path / "chirp_data.npz"), joints=(joint,))
    assert {name: (c.name, c.unit) for name, c in found.columns.items() if name != "time_s"} == {
        "q1_rad": ("dof_pos[3]", "rad"), "q1_cmd_rad": ("des_dof_pos[3]", "rad")}
    wanted = np.interp(found.run.time_s, run.time_s, run["q1_cmd_rad"])
    assert found.run["q1_cmd_rad"] == pytest.approx(wanted, abs=1e-4)  # float32, times too


@pytest.mark.parametrize("v2", [False, True])
def test_lerobot_s_episodes_are_runs_with_names_of_joints(v2: bool, tmp_path: Path) -> None:
    episodes = [arm(1), arm(2, 5.0)]
    paths = lerobot(tmp_path / "set", episodes, 25.0, v2)
    imported = [read_imported(path) for path in paths]
    found = guess_map(imported[0], joints=("elbow_flex",))
    assert found.columns["q1_rad"].name == "observation.state.elbow_flex.pos" + ("" if v2 else "{*}")
    assert found.columns["q1_cmd_rad"].name == "action.elbow_flex.pos" + ("" if v2 else "{*}")
    runs = [apply_map(one, own) for one in imported for _, own in runs_in(one, found.columns)]
    assert [len(run) for run in runs] == [150, 125]
    for run, joints in zip(runs, episodes):
        wanted = joints[SO101.index("elbow_flex")]
        assert run["q1_rad"] == pytest.approx(wanted["q1_rad"][: len(run)], abs=1e-5)
        assert run["q1_cmd_rad"] == pytest.approx(wanted["q1_cmd_rad"][: len(run)], abs=1e-5)


@pytest.mark.parametrize("scale, said", [(1.0, "do not say whether .pos is in degrees or in per cent"),
                                             (2.5, "so they are in degrees")])
def test_what_lerobot_leaves_open_is_said(scale: float, said: str, here: Path,
                                          shell: Shell) -> None:
    (path,) = lerobot(here / "set", [arm(3, scale=scale)], 25.0)
    shell("import", path, "--joints shoulder_lift,elbow_flex,wrist_flex --yes --out runs")
    told = shell.err
    assert said in told and "taken for a chain in one plane" in told
    (here / "set/meta/info.json").write_text("[]")
    with pytest.raises(InputError, match=r"info\.json: is no info"):
        read_imported(path)


@pytest.mark.parametrize("load", ["observation.effort", "observation.current"])
def test_a_load_of_lerobot_is_kept_and_its_unit_asked_for(load: str, here: Path,
                                                          shell: Shell) -> None:
    joints = arm(3)
    (path,) = lerobot(here / "set", [joints], 25.0, load=load)
    shell("import", path, "--joints wrist_flex,elbow_flex --yes --out r")
    told = shell.err
    assert "do not say the unit of" in told and "kept as load1_raw, load2_raw" in told and "tau1_nm" in told
    run = read_csv(here / "r/file-000.csv").columns
    elbow = joints[SO101.index("elbow_flex")]
    error = elbow["q1_cmd_rad"] - elbow["q1_rad"]
    assert run["load2_raw"] == pytest.approx(3.0 / DEGREE * error, abs=1e-3)
    assert "tau1_nm" not in run and run["q2_cmd_rad"] == pytest.approx(elbow["q1_cmd_rad"], abs=1e-5)
    known = here / "columns.toml"
    stated = (here / "r/columns.toml").read_text()
    known.write_text(stated.replace("[columns.load2_raw]", "[columns.tau2_nm]\nscale = 0.5"))
    shell("import", path, "--map columns.toml --out known")
    torque = read_csv(here / "known/file-000.csv").columns["tau2_nm"]
    assert torque == pytest.approx(0.5 * run["load2_raw"], abs=1e-6)


def test_another_robot_of_lerobot_is_in_rad_until_somebody_knows(tmp_path: Path) -> None:
    (path,) = lerobot(tmp_path / "set", [arm(4, scale=np.pi / 180.0)], 25.0, robot="aloha")
    found = guess_map(read_imported(path), joints=("elbow_flex",))
    assert found.columns["q1_rad"].unit in ("", "rad")
    assert any("do not say the unit of the angles of 'aloha'" in text for text in found.warnings)


def test_a_controller_s_state_has_the_names_of_its_joints() -> None:
    from dataclasses import dataclass

    from experiments.exchange.rosbag import _numbers

    @dataclass
    class Point:
        positions: np.ndarray
        velocities: np.ndarray

    @dataclass
    class State:
        joint_names: list[str]
        reference: Point
        feedback: Point

    state = State(["hip", "knee"], *(Point(np.array([k, k + 0.5]), np.zeros(0)) for k in (1.0, 2.0)))
    assert dict(_numbers(state, "/state")) == {
        "/state/reference/hip/position": 1.0, "/state/reference/knee/position": 1.5,
        "/state/feedback/hip/position": 2.0, "/state/feedback/knee/position": 2.5}


def test_bam_s_released_servo_has_no_command(tmp_path: Path) -> None:
    run = servo_run(seconds=6.0, rate_hz=200.0)
    file = bam(tmp_path / "x.json", run, "xl330", released_s=4.0)
    found = guess_map(read_imported(file))
    assert set(found.columns) == {"time_s", "q1_rad", "q1_cmd_rad", "duty", "volts", "torque_enable"}
    within = run.time_s < 3.99
    read = apply_map(read_imported(file), found.columns)
    assert np.array_equal(read["torque_enable"] >= 0.99, read.time_s < 4.0)
    assert read["q1_cmd_rad"][: within.sum()] == pytest.approx(run["q1_cmd_rad"][within], abs=1e-6)
    assert np.isnan(read["q1_cmd_rad"][read.time_s > 4.02]).all() or read.time_s[-1] < 4.02
    duty = np.round(0.25 * 885 * np.sin(3.0 * run.time_s)) / 885
    assert read["duty"][:600] == pytest.approx(duty[:600], abs=1e-9)
    assert any("m*lc = 0.05 kg m" in text for text in found.warnings)
    other = guess_map(read_imported(bam(tmp_path / "y.json", run, "mx106")))
    assert "duty" not in other.columns
    assert any("15.8 (command - angle) at kp 100" in text for text in other.warnings)


def test_a_magnitude_of_torque_in_bam_s_layout_is_no_torque(tmp_path: Path) -> None:
    """As kscalelabs/sysid logs an STS3215: torque and current are never negative, and the load is 0."""
    file = bam(tmp_path / "x.json", servo_run(seconds=6.0, rate_hz=100.0), "sts3215", released_s=4.0)
    content = json.loads(file.read_text())
    for k, entry in enumerate(content["entries"]):
        entry |= {"load": 0, "torque": 3.0 * abs(np.sin(0.1 * k)), "current": 133.6 + k % 5}
    file.write_text(json.dumps(content))
    found = guess_map(read_imported(file))
    assert set(found.columns) == {"time_s", "q1_rad", "q1_cmd_rad", "volts", "torque_enable"}
    assert any("16.6 (command - angle) at kp 100" in text for text in found.warnings)


def test_a_trajectory_is_the_command_at_the_states_times(tmp_path: Path) -> None:
    run = servo_run(seconds=6.0)
    points = np.arange(0.1, 5.9, 0.05)
    found = guess_map(read_imported(trajectory_bag(tmp_path / "bag", run, points)))
    assert {name: c.name for name, c in found.columns.items()} == {
        "q1_rad": "/joint_states/elbow/position", "q1_cmd_rad": "/arm/joint_trajectory/elbow/position"}
    read = found.run
    inside = (read.time_s > 0.2) & (read.time_s < 5.8)
    wanted = np.interp(read.time_s[inside], run.time_s, run["q1_cmd_rad"])
    assert read["q1_cmd_rad"][inside] == pytest.approx(wanted, abs=0.012)  # lines over 50 ms
    assert read.rate_hz == pytest.approx(100.0, rel=0.01)


@pytest.mark.parametrize("multi_turn", [False, True])
def test_feetech_s_registers_are_magnitudes_with_a_sign_bit(multi_turn: bool, tmp_path: Path) -> None:
    run = servo_run()
    found = guess_map(read_imported(feetech(tmp_path / "x.csv", run, multi_turn)))
    assert set(found.columns) == {"time_s", "q1_rad", "q1_cmd_rad", "duty", "volts"}
    shift = np.pi if multi_turn else 0.0
    assert found.run["q1_rad"] + shift == pytest.approx(run["q1_rad"], abs=0.51 * COUNT)
    assert found.run["q1_cmd_rad"] + shift == pytest.approx(run["q1_cmd_rad"], abs=0.51 * COUNT)
    error = np.clip(2.0 * (run["q1_cmd_rad"] - run["q1_rad"]), -1.0, 1.0)
    assert found.run["duty"] == pytest.approx(error, abs=0.51e-3)
    assert found.run["volts"] == pytest.approx(np.full(len(run), 12.1))
    assert any("Feetech are read as 4096 a turn" in text for text in found.warnings)


def test_dynamixel_s_registers_are_read_with_their_bits(tmp_path: Path) -> None:
    run = servo_run()
    found = guess_map(read_imported(dynamixel(tmp_path / "x.csv", run)))
    assert found.run["q1_rad"] + np.pi == pytest.approx(run["q1_rad"], abs=0.51 * COUNT)
    assert found.run["duty"] == pytest.approx(np.clip(run["q1_cmd_rad"] - run["q1_rad"], -1, 1), abs=0.51 / 885)
    assert found.run["volts"] == pytest.approx(np.full(len(run), 5.0))
    assert any("of a Dynamixel" in text for text in found.warnings)


@pytest.mark.parametrize("name", ["Torque_Enable", "servo.torque_enable", "Torque Enable"])
def test_a_register_says_whether_the_motor_is_on(name: str, tmp_path: Path) -> None:
    run = servo_run()
    path = dynamixel(tmp_path / "x.csv", run)
    head, *rows = path.read_text().splitlines()
    lines = [f"{head},{name}", *(f"{row},{int(t < 3.0)}" for row, t in zip(rows, run.time_s))]
    path.write_text("\n".join(lines) + "\n")
    found = guess_map(read_imported(path))
    assert found.columns["torque_enable"].name == name
    assert np.array_equal(found.run["torque_enable"] >= 0.99, found.run.time_s < 3.0)


def test_degrees_in_whole_numbers_are_no_counts(tmp_path: Path) -> None:
    run = servo_run()
    found = guess_map(read_imported(table(tmp_path / "x.csv", {
        "time": run.time_s, "present_position": np.round(run["q1_rad"] / DEGREE),
        "goal_position": run["q1_cmd_rad"] / DEGREE}))).columns["q1_rad"]
    assert found.scale == 1.0 and found.unit == "deg"


def test_a_pointer_of_git_lfs_is_named(tmp_path: Path) -> None:
    (tmp_path / "x.parquet").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 10\n")
    with pytest.raises(InputError, match=r"is a pointer of Git LFS.*git lfs pull"):
        read_imported(tmp_path / "x.parquet")


def test_json_of_others_is_no_recording_of_bam(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text(json.dumps({"kp": 3, "entries": "none", "t": [0.1 * k for k in range(60)]}))
    assert not read_imported(tmp_path / "x.json").facts
