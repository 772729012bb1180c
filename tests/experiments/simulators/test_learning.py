"""`legid export --to learning`: modules for simulators of policy learning, and what their joints lack."""

import ast
import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from daq import InputError
from experiments.cli import main
from experiments.models import save_model
from experiments.simulators import SIMULATORS, learning_files, reduced
from tests.support.exported_models import EFFECTS, model_of, simulated
from tests.support.models import LEG_RIG


def test_every_effect_has_a_fate_in_every_simulator(tmp_path: Path) -> None:
    for name in EFFECTS:
        for simulator in SIMULATORS:
            (fate,) = reduced(model_of(tmp_path, 1, (name,)), simulator).fates
            assert fate.how in ("held", "nearest", "left out") and fate.words


def test_what_is_like_friction_is_kept_as_friction(tmp_path: Path) -> None:
    model = model_of(tmp_path, 1, ("asymmetric_friction", "backlash"))
    found = reduced(model, SIMULATORS[0]).model
    assert found.beta[8] == pytest.approx(model.beta[8] + 0.01 + 0.01)
    assert found.beta[6] == pytest.approx(model.beta[6] + 0.005 + 0.01)
    assert [effect.name for effect in found.effects] == ["rotor_inertia"]


def test_files_are_python_and_models_with_the_numbers(tmp_path: Path) -> None:
    model = model_of(tmp_path, 1, ("torque_delay", "rotor_inertia", "stribeck_friction", "joint_stiffness"))
    texts = learning_files(model, "m.json")
    trees = {name: ast.parse(text) for name, text in texts.items() if name.endswith(".py")}
    assert len(trees) == 4
    numbers = {name: {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}
               for name, tree in trees.items()}
    for name, found in numbers.items():
        assert {0.004, model.beta[8]} <= found, name
    assert model.beta[8] + 0.03 in numbers["isaaclab_leg.py"]
    assert 2 in numbers["isaaclab_leg.py"] & numbers["mjlab_leg.py"] & numbers["newton_leg.py"]  # 12 ms, 5 ms a step
    assert mujoco.MjModel.from_xml_string(texts["leg.xml"]).jnt_stiffness[0] == pytest.approx(0.4)
    (tmp_path / "leg.urdf").write_text(texts["leg.urdf"])
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "leg.urdf")).nq == 2


def test_the_difference_is_measured_on_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A leg with a delay of 12 ms and a spring: what does not hold the spring errs most."""
    model = model_of(tmp_path, 1, ("torque_delay", "joint_stiffness"),
                     noise={"encoder_rad": 1e-3, "torque_nm": 0.01, "gyro_radps": 0.005, "accel_mps2": 0.05})
    save_model(model, tmp_path / "m.json")
    (tmp_path / "rig.toml").write_text(LEG_RIG.format(q1=1.0))
    run, rng = simulated(model), np.random.default_rng(1)
    sigma = {"q2_rad": 1e-3, "tau2_nm": 0.01, "gyro_radps": 0.005, "accel_x_mps2": 0.05, "accel_y_mps2": 0.05}
    rows = np.column_stack([run.time_s, *(run[c] + s * rng.standard_normal(len(run)) for c, s in sigma.items())])
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header=",".join(["time_s", *sigma]), comments="")
    assert main(["export", str(tmp_path / "m.json"), "--to", "learning", "--out", str(tmp_path / "rl"), "--starts",
                 str(tmp_path / "run.csv"), "--rig", str(tmp_path / "rig.toml")]) == 0
    said = capsys.readouterr().out
    errors = {cells[1].strip(): float(cells[2]) for line in said.splitlines()
              if len(cells := line.split("|")) > 3 and cells[1].strip() in ("model", "mjlab", "Newton", "Genesis")}
    assert max(errors["model"], errors["mjlab"]) < 0.5 * min(errors["Newton"], errors["Genesis"]), said
    assert (tmp_path / "rl" / "README.md").is_file()


def test_bam_gets_what_the_model_knows_of_a_servo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = model_of(tmp_path, 1, ("stribeck_friction", "rotor_inertia"))
    found = json.loads(learning_files(model, "m.json", servo="mx106")["bam.json"])
    stribeck = model.effects[0]
    assert (found["model"], found["actuator"]) == ("m2", "mx106") and "kt" not in found and "R" not in found
    assert found["friction_base"] == model.beta[8] and found["friction_viscous"] == model.beta[6]
    assert found["armature"] == pytest.approx(0.004)
    assert found["dtheta_stribeck"] == stribeck.shapes["stribeck_velocity"]
    assert found["friction_stribeck"] == stribeck.sizes["excess_torque"]
    by_load = json.loads(learning_files(model_of(tmp_path, 1, ("load_dependent_friction",)), "m.json", servo="xl330")[
        "bam.json"])
    assert by_load["model"] == "m3" and by_load["load_friction_base"] > 0.0
    save_model(model, tmp_path / "m.json")
    command = ["export", str(tmp_path / "m.json"), "--out", str(tmp_path / "rl"), "--servo"]
    assert main([*command, "mx28", "--to", "learning"]) == 2 and main([*command, "mx64", "--to", "mjcf"]) == 2
    assert "none that BAM bundles" in capsys.readouterr().err


def test_bam_s_m5_brakes_as_the_effect_does(tmp_path: Path) -> None:
    model = model_of(tmp_path, 1, ("directional_load_friction",))
    found = json.loads(learning_files(model, "m.json", servo="xl330")["bam.json"])
    (effect,) = model.effects
    assert found["model"] == "m5" and found["friction_base"] == model.beta[8]
    k, near, share = (*effect.sizes.values(), effect.shapes["load_share"])
    for motor, external, rate in ((0.3, -0.2, 0.1), (0.3, 0.2, 1.0), (-0.1, 0.4, 0.02)):
        law = (k + near * np.exp(-((rate / effect.shapes["stribeck_velocity"]) ** 2))) * abs(
            (1.0 - share) * motor - share * external)
        close = np.exp(-(abs(rate / found["dtheta_stribeck"]) ** found["alpha"]))
        theirs = abs(external * found["load_friction_external"] - motor * found["load_friction_motor"]) + close * (
            found["friction_stribeck"] + abs(external * found["load_friction_external_stribeck"]
                                             - motor * found["load_friction_motor_stribeck"]))
        assert theirs == pytest.approx(law, rel=1e-12)


@pytest.mark.parametrize("other", ["stribeck_friction", "load_dependent_friction"])
def test_what_no_m5_of_bam_holds_is_refused(other: str, tmp_path: Path) -> None:
    model = model_of(tmp_path, 1, ("directional_load_friction", other))
    with pytest.raises(InputError, match=f"directional_load_friction together with {other}"):
        learning_files(model, "m.json", servo="xl330")
