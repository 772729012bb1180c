"""Files of joints that follow commands: what a guess makes of them, and where a user is led."""

from pathlib import Path

import numpy as np
import pytest

from daq import Dataset, InputError, load_rig, parse_rig
from daq.runs import commanded, is_contract_column, missing
from experiments.exchange import guess_map, read_imported
from tests.support.imported_files import table
from tests.support.mujoco_leg import random_leg
from tests.support.servo_joint import GAIN, INERTIA, MOMENT, servo_run
from tests.support.servo_leg import follow
from tests.support.shell import Shell, document, typed

DEGREE = np.pi / 180.0


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


def test_a_log_of_commands_goes_to_the_gain_in_four_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                            shell: Shell) -> None:
    for k in (1, 2):
        log(tmp_path / f"log{k}.csv", servo_run(seed=k))
    monkeypatch.chdir(tmp_path)
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


def test_a_session_that_logged_no_command_is_imported_without_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                                 shell: Shell) -> None:
    first = log(tmp_path / "log1.csv", servo_run())
    run = servo_run(seed=2)
    table(tmp_path / "log2.csv", {"time": run.time_s, "knee_deg": run["q1_rad"] / DEGREE})
    monkeypatch.chdir(tmp_path)
    shell("import", first.name, "log2.csv --yes --out runs")
    assert "log2.csv has no column 'knee_cmd_deg', and so no q1_cmd_rad" in shell.err
    header = (tmp_path / "runs/log2.csv").read_text().splitlines()
    assert any("q1_rad" in line for line in header[:9]) and not any("q1_cmd_rad" in line for line in header[:9])
