"""IMUs beyond link 1 as a person uses them: rig.toml, CSV files, fit, validate, simulate, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.runs import read_csv, write_csv
from estimator.model import leg2
from tests.support.mujoco_tree import FRICTION_RADPS, Sensor, Tree, disturbed, move, random_tree, torques
from tests.support.shell import Shell, document

RIG = """[mechanism]
model = "leg2"
actuated = [2]
link_lengths_m = [{length}]
{encoders}
{imus}
[terms]
friction_velocity_radps = 0.05
rotor_inertia = []
torque_offset = []
[sampling]
hold = "linear"
rate_hz = 100.0
"""
ON_SHANK, ON_THIGH = "[[imu]]\nlink = 2\nlever_arm_m = 0.1\n", "[[imu]]\nlever_arm_m = 0.2\n"
Laid = tuple[Path, Tree]


@pytest.fixture(scope="module")
def laid(module_path: Path) -> Laid:
    """Two runs of one leg with an IMU on the shank, then one on the thigh, and rig files of both uses."""
    rng = np.random.default_rng(7)
    tree = random_tree(rng, (-1, 0), viscous=0.03, coulomb=0.04)
    for k in range(2):
        motion = move(tree, torques(tree, rng, 8.0, 100.0, 0.35, (1,)), 100.0, [Sensor(1, 0.1), Sensor(0, 0.2)])
        data = disturbed(motion, (1,), 100.0, rng)
        angles, second = ("q1_rad", "q2_rad"), ("gyro2_radps", "accel2_x_mps2", "accel2_y_mps2")
        for name, left_out in (("shank", ("q1_rad", *second)), ("two", angles)):
            kept = {column: values for column, values in data.columns.items() if column not in left_out}
            write_csv(replace(data, columns=kept), module_path / f"{name}{k}.csv")
    length = float(tree.length[0])
    alone = ON_SHANK.replace("[[imu]]", "[imu]")
    (module_path / "shank.toml").write_text(RIG.format(length=length, encoders="", imus=alone))
    (module_path / "two.toml").write_text(RIG.format(length=length, encoders="encoders = []", imus=ON_SHANK + ON_THIGH))
    return module_path, tree


@pytest.mark.parametrize("use", ["shank", "two"])
def test_fit_validate_and_simulate(laid: Laid, use: str, here: Path, shell: Shell) -> None:
    folder, tree = laid
    rig = folder / f"{use}.toml"
    fitted = document("fit", folder / f"{use}0.csv", "--rig", rig, "--model-out model.json")
    assert "on link 2 rides on links of exactly the lengths declared" in shell.out
    truth = tree.beta(leg2(velocity_scale=FRICTION_RADPS))
    for parameter, true in zip(fitted["parameters"], truth):
        assert abs(parameter["value"] - true) < 4.0 * parameter["std"], parameter["name"]
    assert ("gyro2_radps" in fitted["noise"]) == (use == "two")
    shell("validate model.json", folder / f"{use}1.csv", "--rig", rig)
    assert "TRUST for simulation" in shell.out
    rows = [f"{0.01 * k:.2f},{0.3 * np.sin(0.1 * k):.4f}" for k in range(100)]
    (here / "plan.csv").write_text("\n".join(["time_s,tau2_cmd_nm", *rows, ""]))
    shell("simulate model.json --plan plan.csv --out simulated.csv --noise-seed 1")
    columns = read_csv(here / "simulated.csv").columns
    assert ("accel2_y_mps2" in columns) == (use == "two")
    # at rest both hang still: y feels gravity, the gyro nothing
    assert columns["accel_y_mps2"][0] == pytest.approx(-9.81, abs=0.4) and abs(columns["gyro_radps"][0]) < 0.05


@pytest.mark.parametrize("old, new, status, said", [
    ("encoders = []", "encoders = [3]", 2, "mechanism.encoders names joint 3, leg2 has 2"),
    (ON_THIGH, "", 1, "no sensor tells the angles of joints 1 and 2 apart: with 0 encoders and 1 IMU"),
    ("link = 2", "link = 3", 2, "IMU 1 is on link 3, leg2 has 2"),
    ("link_lengths_m", "# link_lengths_m", 2, "rides on link 1, whose length is not given"),
    (ON_THIGH, ON_THIGH + ON_THIGH, 2, "column gyro3_radps is missing")])
def test_what_cannot_be_used_is_said_in_one_line(laid: Laid, old: str, new: str, status: int, said: str, here: Path,
                                                 shell: Shell) -> None:
    folder, _ = laid
    text = (folder / "two.toml").read_text()
    assert old in text
    (here / "rig.toml").write_text(text.replace(old, new))
    assert said in shell.fails("fit", folder / "two0.csv", "--rig rig.toml", status=status)


def test_methods_and_diagnoses_that_know_one_imu_refuse_more(laid: Laid, shell: Shell) -> None:
    folder, _ = laid
    rig, runs = folder / "two.toml", [folder / f"two{k}.csv" for k in range(2)]
    said = shell.fails("fit", *runs, "--rig", rig, "--method wls", status=1)
    assert "--method wls knows one IMU on link 1 and encoders of all other joints" in said
    assert "has 2 IMUs; a diagnosis knows the faults of one" in shell.fails("diagnose", *runs, "--rig", rig)
