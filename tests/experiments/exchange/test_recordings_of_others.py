"""Recordings in the layouts of other projects, and files of joints that follow commands."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq import Dataset, InputError, load_rig, parse_rig
from daq.runs import commanded, is_contract_column, missing, read_csv
from experiments.exchange import apply_map, guess_map, read_imported, runs_in
from tests.support.imported_files import table
from tests.support.mujoco_leg import random_leg
from tests.support.public_layouts import SO101, bam, dynamixel, feetech, lerobot, trajectory_bag
from tests.support.servo_joint import GAIN, INERTIA, MOMENT, servo_run
from tests.support.servo_leg import follow
from tests.support.shell import Shell, document, typed
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


def log(path: Path, run: Dataset, names: tuple[str, str] = ("knee_cmd_deg", "knee_deg"),
        units: tuple[float, float] = (DEGREE, DEGREE), signs: tuple[int, int] = (1, 1)) -> Path:
    return table(path, {"time": run.time_s, names[0]: signs[0] * run["q1_cmd_rad"] / units[0],
                        names[1]: signs[1] * run["q1_rad"] / units[1]})


@pytest.mark.parametrize("names, units, signs, expected", [
    (("knee_cmd_deg", "knee_deg"), (DEGREE, DEGREE), (1, 1), ("deg", "deg", 1)),
    (("knee_cmd_deg", "knee_rad"), (DEGREE, 1.0), (1, 1), ("deg", "rad", 1)),
    (("goal [deg]", "pos"), (DEGREE, 1.0), (1, 1), ("deg", "rad", 1)),
    (("position_setpoint", "position [turn]"), (1.0, 2.0 * np.pi), (1, 1), ("rad", "turn", 1)),
    (("q_target", "q"), (1.0, 1.0), (-1, 1), ("", "", -1)),
    (("target_angle", "angle"), (DEGREE, DEGREE), (1, 1), ("deg", "deg", 1))])
def test_a_command_has_the_unit_and_sign_of_the_angle_that_follows_it(
        names: tuple[str, str], units: tuple[float, float], signs: tuple[int, int], expected: tuple[str, str, int],
        tmp_path: Path) -> None:
    found = guess_map(read_imported(log(tmp_path / "x.csv", servo_run(), names, units, signs)))
    assert not found.unexplained
    command, angle = found.columns["q1_cmd_rad"], found.columns["q1_rad"]
    assert (command.name, angle.name) == names
    assert (command.unit, angle.unit, command.sign) == expected
    run = servo_run()
    assert found.run["q1_rad"] == pytest.approx(signs[1] * run["q1_rad"], abs=1e-6)
    assert found.run["q1_cmd_rad"] == pytest.approx(signs[1] * run["q1_cmd_rad"], abs=1e-6)


def test_a_log_of_commands_goes_to_the_gain_in_four_commands(here: Path,
                                                            shell: Shell) -> None:
    for k in (1, 2):
        log(here / f"log{k}.csv", servo_run(seed=k))
    shell("import log1.csv log2.csv --yes --out runs")
    said = shell.read()
    assert "lacks" not in said.err and "[servo], which legid init --from RUN.csv writes" in said.err
    shell("init --from runs/log1.csv rig.toml")
    assert "give the gain under [servo], or one parameter with --fix" in shell.out
    rig = load_rig("rig.toml")
    assert (rig.mechanism.model, rig.mechanism.actuated) == ("joint1", (1,)) and rig.servo is not None
    told = document("fit runs/log1.csv runs/log2.csv --rig rig.toml --fix", f"beta2={MOMENT}")
    assert told["servo_gain"]["value"] == pytest.approx(GAIN, rel=0.03)
    assert told["parameters"][0]["value"] == pytest.approx(INERTIA, rel=0.1)
    for command in ("info runs/log1.csv", "runs runs"):
        shell(command)
        assert "follows q1_cmd_rad" in shell.out


@pytest.mark.parametrize("sign", [1, -1])
def test_a_leg_s_knee_follows_a_command(sign: int, here: Path) -> None:
    run = follow(random_leg(61), 62, gain=6.0)
    file = table(here / "leg.csv", {
        "time": run.time_s, "hip_deg": run["q1_rad"] / DEGREE, "knee_deg": sign * run["q2_rad"] / DEGREE,
        "knee_cmd_deg": sign * run["q2_cmd_rad"] / DEGREE})
    found = guess_map(read_imported(file))
    assert set(found.columns) == {"time_s", "q1_rad", "q2_rad", "q2_cmd_rad"} and not found.unexplained
    assert [found.columns[name].sign for name in ("q2_rad", "q2_cmd_rad")] == [sign, sign]
    assert all(found.columns[name].unit == "deg" for name in ("q1_rad", "q2_rad", "q2_cmd_rad"))
    typed("import leg.csv --yes --out runs")
    typed("init --from runs/leg.csv rig.toml")
    rig = load_rig(here / "rig.toml")
    assert (rig.mechanism.model, rig.mechanism.actuated) == ("leg2", (2,)) and rig.servo is not None


@pytest.mark.parametrize("unit, sign", [("deg", 1), ("", -1)])
def test_a_commanded_rate_and_a_feedforward_come_along(unit: str, sign: int, tmp_path: Path) -> None:
    run = servo_run()
    scale = DEGREE if unit else 1.0
    rate = np.gradient(run["q1_cmd_rad"], 0.01)
    columns = {"time": run.time_s, "elbow_pos_" + unit: run["q1_rad"] / scale,
               "elbow_cmd_" + unit: run["q1_cmd_rad"] / scale, "elbow_vel_cmd": sign * rate / scale,
               "elbow_torque_ff_nm": 0.3 * np.sin(run["q1_cmd_rad"])}
    found = guess_map(read_imported(table(tmp_path / "x.csv", columns)))
    assert set(found.columns) == {"time_s", "q1_rad", "q1_cmd_rad", "qd1_cmd_radps", "tau1_ff_nm"}
    assert found.run["qd1_cmd_radps"] == pytest.approx(rate, abs=1e-5)
    assert found.run["tau1_ff_nm"] == pytest.approx(0.3 * np.sin(run["q1_cmd_rad"]), abs=1e-6)
    columns["elbow_vel_cmd"] = np.sin(2.0 * np.pi * 2.9 * run.time_s)
    assert "qd1_cmd_radps" not in guess_map(read_imported(table(tmp_path / "y.csv", columns))).columns


def test_a_command_that_nothing_follows_is_left_out(tmp_path: Path) -> None:
    run = servo_run()
    other = np.sin(2.0 * np.pi * 3.7 * run.time_s + 0.3)
    file = table(tmp_path / "x.csv", {"time": run.time_s, "angle": run["q1_rad"], "target": other})
    found = guess_map(read_imported(file))
    assert set(found.columns) == {"time_s", "q1_rad"}
    assert any("'angle' does not follow 'target'" in text for text in found.warnings)


def test_a_torque_stays_and_the_command_comes_along(tmp_path: Path) -> None:
    run = servo_run()
    torque = GAIN * (run["q1_cmd_rad"] - run["q1_rad"]) - 0.1 * np.gradient(run["q1_rad"], 0.01)
    found = guess_map(read_imported(table(tmp_path / "x.csv", {
        "time": run.time_s, "pos": run["q1_rad"], "effort": torque, "pos_cmd": run["q1_cmd_rad"]})))
    assert set(found.columns) == {"time_s", "q1_rad", "tau1_nm", "q1_cmd_rad"}


def test_of_many_joints_some_are_chosen_by_name_or_number(tmp_path: Path) -> None:
    run = servo_run()
    names = [f"joint{k}" for k in range(6)]
    columns = {"time": run.time_s} | {f"{name}_pos": run["q1_rad"] + 0.01 * k for k, name in enumerate(names)}
    columns |= {f"{name}_pos_cmd": run["q1_cmd_rad"] + 0.01 * k for k, name in enumerate(names)}
    file = read_imported(table(tmp_path / "x.csv", columns))
    with pytest.raises(InputError, match=r"holds 6 joints: 'joint0_pos'.*--joints NAME"):
        guess_map(file)
    one = guess_map(file, joints=("joint3_pos",)).columns
    assert (one["q1_rad"].name, one["q1_cmd_rad"].name) == ("joint3_pos", "joint3_pos_cmd")
    two = guess_map(file, joints=("5", "2")).columns
    assert [two[name].name for name in ("q1_rad", "q1_cmd_rad", "q2_rad", "q2_cmd_rad")] == [
        "joint4_pos", "joint4_pos_cmd", "joint1_pos", "joint1_pos_cmd"]
    with pytest.raises(InputError, match="no angle is called 'elbow'"):
        guess_map(file, joints=("elbow",))


def test_commands_are_columns_of_a_run() -> None:
    assert all(map(is_contract_column, ("q1_cmd_rad", "q2_cmd_rad", "qd2_cmd_radps", "tau2_ff_nm", "tau7_nm")))
    assert not any(map(is_contract_column, ("qd2_rad", "q2_cmd_radps", "tau2_cmd_rad", "q2_ff_nm", "qd21_cmd_radps")))
    assert commanded(["time_s", "q1_rad", "q2_cmd_rad", "tau1_nm", "q1_cmd_rad"]) == (2,)


def test_who_has_a_command_is_led_to_the_servo() -> None:
    rig = parse_rig('[mechanism]\nmodel = "leg2"\nactuated = [2]\n')
    lacking = missing(rig, ["time_s", "q1_rad", "q2_rad", "q2_cmd_rad"])
    assert "[servo]" in lacking.remedy and "actuated" not in lacking.remedy
    nothing = missing(rig, ["time_s", "q1_rad", "q2_rad"])
    assert "q2_cmd_rad" in nothing.remedy


def test_a_session_that_logged_no_command_is_imported_without_it(here: Path,
                                                                 shell: Shell) -> None:
    first = log(here / "log1.csv", servo_run())
    run = servo_run(seed=2)
    table(here / "log2.csv", {"time": run.time_s, "knee_deg": run["q1_rad"] / DEGREE})
    shell("import", first.name, "log2.csv --yes --out runs")
    assert "log2.csv has no column 'knee_cmd_deg', and so no q1_cmd_rad" in shell.err
    header = (here / "runs/log2.csv").read_text().splitlines()
    assert any("q1_rad" in line for line in header[:9]) and not any("q1_cmd_rad" in line for line in header[:9])
