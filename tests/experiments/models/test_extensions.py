"""Models with effects or a structure are models: saved, read, simulated, validated; an independent plant judges."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import legid
from daq import InputError
from daq.recording import read_plan, write_plan
from estimator import Diagnosis
from estimator.effects import classes
from estimator.effects.encoder_scale import EncoderScale
from experiments.documents import DiagnosisDocument, finite, learnt_of
from experiments.emulation import LegBody
from experiments.emulation.hidden_effects import DRAG, REST_RAD, SPRING_NM
from experiments.excite import random_multisine
from experiments.models import (
    EffectValue,
    Model,
    TorqueTable,
    effect_value,
    effects_of,
    load_model,
    save_model,
    structure_values,
    values_of,
)
from experiments.models.schema import JointTorque, StructureValues, TableInput
from experiments.models.structure import laws_of
from experiments.reports.structure import structure_section, structure_words
from tests.support.extended_models import assert_moves_as_the_plant, model_with, noisy_run, run_of
from tests.support.learnt import hidden_magnet
from tests.support.shell import Shell, document, read_json

SPRING = EffectValue(name="joint_stiffness", joint=2, sizes={"stiffness": SPRING_NM, "preload": SPRING_NM * REST_RAD})


@pytest.mark.parametrize("kind", classes(), ids=lambda kind: kind.name)
def test_every_effect_is_saved_and_read(kind: Any, tmp_path: Path) -> None:
    effect = kind(1 if kind.per_joint or kind.per_motor else None)
    size = np.linspace(0.1, 0.3, effect.count)
    model = model_with(effect_value(effect, size))
    save_model(model, tmp_path / "m.json")
    back = load_model(tmp_path / "m.json")
    assert back == model
    ((again, values),) = effects_of(back)
    assert type(again) is kind and again.joint == effect.joint
    assert_array_equal(values, size)
    stored = read_json(tmp_path / "m.json")["effects"][0]
    assert set(stored) == {"name", "joint", "sizes", "shapes"} and stored["joint"] == (
        2 if kind.per_joint or kind.per_motor else None)


def test_an_encoder_behind_a_loop_is_saved_with_what_the_loop_hears(tmp_path: Path) -> None:
    model = model_with(effect_value(EncoderScale(1, by_law=True), np.array([0.05, 0.0])))
    save_model(model, tmp_path / "m.json")
    ((again, values),) = effects_of(load_model(tmp_path / "m.json"))
    assert values.tolist() == [0.05, 0.0] and again.told(values).endswith("and the loop hears the true angle")


@pytest.mark.parametrize("name, value", [
    ("joint_stiffness", SPRING),
    ("quadratic_drag", EffectValue(name="quadratic_drag", joint=2, sizes={"drag": DRAG})),
    ("rotor_inertia", EffectValue(name="rotor_inertia", joint=2, sizes={"inertia": 0.004})),
    ("asymmetric_friction", EffectValue(name="asymmetric_friction", joint=2, sizes={
        "coulomb_difference": 0.03, "viscous_difference": 0.0})),
])
def test_extended_simulation_is_the_motion_of_a_plant_with_the_effect(name: str, value: EffectValue,
                                                                      tmp_path: Path) -> None:
    assert_moves_as_the_plant(model_with(value), name, tmp_path)


@pytest.mark.parametrize("value, column, difference", [
    (EffectValue(name="gyro_bias", joint=None, sizes={"bias": 0.02}), "gyro_radps", 0.02),
    (EffectValue(name="torque_offset", joint=None, sizes={"offset": -0.03}), "tau2_nm", -0.03),
    (EffectValue(name="encoder_offset", joint=2, sizes={"offset": 0.01}), "q2_rad", 0.01),
])
def test_a_sensor_effect_changes_its_reading_and_nothing_else(value: EffectValue, column: str, difference: float,
                                                              tmp_path: Path) -> None:
    extended, plain = run_of(model_with(value), tmp_path), run_of(model_with(), tmp_path)
    for name, values in plain.items():
        assert_allclose(extended[name] - values, difference if name == column else 0.0, atol=1e-6)


def test_noise_of_a_simulation_is_that_of_the_model(tmp_path: Path) -> None:
    noise = {"accel_mps2": 0.3, "accel_x_mps2": 0.05, "accel_y_mps2": 0.4, "accel_correlation": 0.8, "gyro_radps": 0.01}
    plain, noisy, again, other = (run_of(msgspec.structs.replace(model_with(), noise=noise), tmp_path, *words)
                                  for words in ((), *(("--noise-seed", seed) for seed in "334")))
    left = np.array([noisy[c] - plain[c] for c in ("accel_x_mps2", "accel_y_mps2", "gyro_radps", "q2_rad")])
    assert left[:3].std(axis=1) == pytest.approx([0.05, 0.4, 0.01], rel=0.06) and not left[3].any()
    assert_array_equal(noisy["gyro_radps"], again["gyro_radps"])
    assert not np.array_equal(noisy["gyro_radps"], other["gyro_radps"])
    assert np.corrcoef(left[:3])[0] == pytest.approx([1.0, 0.8, 0.0], abs=0.08)


def test_a_late_imu_shows_what_was(tmp_path: Path) -> None:
    late = EffectValue(name="sensor_time_skew", joint=None, sizes={"skew": 0.01})
    extended, plain = run_of(model_with(late), tmp_path), run_of(model_with(), tmp_path)
    assert_allclose(extended["gyro_radps"][12:-10], plain["gyro_radps"][10:-12], atol=1e-3)


@pytest.mark.parametrize("value, gains", [
    (EffectValue(name="joint_stiffness", joint=2, sizes={"stiffness": 0.1, "preload": 0.03}), True),
    (EffectValue(name="torque_offset", joint=None, sizes={"offset": 0.05}), True),
    (EffectValue(name="sensor_time_skew", joint=None, sizes={"skew": 0.002}), False),  # the motion is the nominal one
])
def test_validate_runs_the_extended_model(value: EffectValue, gains: bool, here: Path) -> None:
    rig = noisy_run(model_with(value), here)
    rmse = {}
    for name in ("m", "plain") if gains else ("m",):
        (run,) = document(f"validate {name}.json run.csv --rig", rig)["runs"]
        assert not run["diverged"] and run["horizon_s"] == pytest.approx(8.0, abs=0.1)
        rmse[name] = run["rmse"]
    assert rmse["m"]["q1_rad"] < 0.01 and rmse["m"]["q2_rad"] < 0.03
    assert not gains or rmse["m"]["q2_rad"] < 0.5 * rmse["plain"]["q2_rad"]


def test_reference_values_carry_what_is_not_determined() -> None:
    covariance = [list(row) for row in model_with().covariance]
    covariance[8][8] = None
    model = msgspec.structs.replace(model_with(), covariance=tuple(map(tuple, covariance)))
    found = values_of(model)
    assert found["beta1"] == (pytest.approx(LegBody().beta()[0]), pytest.approx(1e-4)) and found["beta9"][1] == np.inf


@pytest.mark.parametrize("change, says", [
    ({"name": "warp_drive"}, "warp_drive"), ({"joint": None}, "no joint"), ({"joint": 3}, "reach"),
    ({"sizes": {"stiffness": 1.0}}, "stiffness, preload"), ({"shapes": {"angle": 1.0}}, "shapes angle"),
    ({"sizes": {"stiffness": 1.0, "preload": "x"}}, "effects[0].sizes"), ({"size": 1}, "size"),
])
def test_effects_that_cannot_be_run_are_named(change: dict[str, Any], says: str, here: Path, shell: Shell) -> None:
    document = json.loads(msgspec.json.encode(model_with(SPRING)))
    document["effects"][0] |= change
    (here / "m.json").write_text(json.dumps(document))
    write_plan(random_multisine(5, 6.0, 0.5), here / "p.csv")
    error = shell.fails("simulate m.json --plan p.csv --out r.csv")
    assert says in error and "m.json: " in error and not (here / "r.csv").exists()


def test_covariance_and_reach_belong_to_the_effects(tmp_path: Path) -> None:
    for change, says in (({"covariance": model_with().covariance}, "11 by 11"), ({"reach": ()}, "reach")):
        save_model(msgspec.structs.replace(model_with(SPRING), **change), tmp_path / "m.json")
        with pytest.raises(InputError, match=says):
            load_model(tmp_path / "m.json")


def test_a_file_from_before_a_shape_existed_reads_as_its_default(tmp_path: Path) -> None:
    old = EffectValue(name="stribeck_friction", joint=2, sizes={"excess_torque": 0.05},
                      shapes={"stribeck_velocity": 0.2})
    after = EffectValue(name="gyro_bias", joint=None, sizes={"bias": 0.03})
    save_model(model_with(old, after), tmp_path / "m.json")
    model = load_model(tmp_path / "m.json")
    assert model.effects[0].shapes == {"stribeck_velocity": 0.2, "exponent": 2.0}
    assert [row[k] for k, row in enumerate(model.covariance)] == [1e-8] * 11 + [0.0, 1e-8]
    (_, size), (_, bias) = effects_of(model)
    assert list(size) == [0.05, 0.2, 2.0] and list(bias) == [0.03]


SPRING_TABLE = TorqueTable(inputs=(TableInput(variable="angle", joint=2),), knots=((-2.0, 2.0),), std=(0.001, 0.001),
                     values=(SPRING_NM * (-2.0 - REST_RAD), SPRING_NM * (2.0 - REST_RAD)))


def with_table(table: TorqueTable) -> Model:
    torque = JointTorque(joint=2, constant=0.0, tables=(table,), noise_nm=0.01)
    structure = StructureValues(torques=(torque,), removed=0.5, removed_ci95=(0.4, 0.6))
    return msgspec.structs.replace(model_with(), structure=structure)


def test_it_is_saved_and_read_and_old_files_have_none(tmp_path: Path) -> None:
    model = with_table(SPRING_TABLE)
    save_model(model, tmp_path / "m.json")
    assert load_model(tmp_path / "m.json") == model
    document = read_json(tmp_path / "m.json")
    del document["structure"]
    (tmp_path / "m.json").write_text(json.dumps(document))
    assert load_model(tmp_path / "m.json").structure is None and laws_of(load_model(tmp_path / "m.json")) == ()


def test_a_learnt_structure_survives_the_file() -> None:
    found = hidden_magnet()
    model = msgspec.structs.replace(model_with(), structure=structure_values(found))
    (law,), (again,) = found.laws, laws_of(model)
    assert_array_equal(again.torque(found.samples.at), law.torque(found.samples.at))
    assert model.structure.removed == found.removed


@pytest.mark.parametrize("change, says", [
    ({"knots": [[2.0, -2.0]]}, "do not increase"), ({"values": [1.0]}, "1 values for 2 knots"),
    ({"inputs": []}, "one list of knots"), ({"inputs": [{"variable": "angle", "joint": 3}]}, "joint 3"),
    ({"inputs": [{"variable": "mood", "joint": 1}]}, "mood"), ({"std": [-1.0, 1.0]}, "std"),
])
def test_a_structure_that_cannot_be_run_is_named(change: dict[str, Any], says: str, tmp_path: Path) -> None:
    document = json.loads(msgspec.json.encode(with_table(SPRING_TABLE)))
    document["structure"]["torques"][0]["tables"][0] |= change
    (tmp_path / "m.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=says):
        load_model(tmp_path / "m.json")


def test_simulation_is_the_motion_of_a_plant_with_that_torque(tmp_path: Path) -> None:
    assert_moves_as_the_plant(with_table(SPRING_TABLE), "joint_stiffness", tmp_path)


def test_validate_and_compare_use_it(tmp_path: Path) -> None:
    rig = noisy_run(with_table(SPRING_TABLE), tmp_path)
    model, plain, log = (tmp_path / name for name in ("m.json", "plain.json", "run.csv"))
    (run,) = document("validate", model, log, "--rig", rig, "--horizons 0.5")["runs"]
    assert run["rmse"]["q1_rad"] < 0.01 and run["rmse"]["q2_rad"] < 0.03
    told = document("compare", model, plain, log, "--rig", rig, "--horizons 0.5")
    assert all(row["b"] > 2.0 * row["a"] for row in told["errors"])


def test_a_motion_beyond_its_range_is_told(tmp_path: Path, shell: Shell) -> None:
    narrow = msgspec.structs.replace(SPRING_TABLE, knots=((-0.05, 0.05),), values=(-0.01, 0.01))
    run_of(with_table(narrow), tmp_path)
    said = shell.err
    assert "angle of joint 2" in said and "leaves the range" in said
    run_of(with_table(SPRING_TABLE), tmp_path)
    assert "leaves the range" not in shell.err
    with pytest.warns(UserWarning, match="angle of joint 2"):
        legid.simulate(with_table(narrow), read_plan(tmp_path / "plan.csv"))


def test_reports_say_what_it_removes_and_where() -> None:
    found = hidden_magnet()
    told = learnt_of(found)
    assert told is not None
    words = structure_words(told)
    assert f"removes {100.0 * found.removed:.0f} % [" in words and "joint 2, as a function of angle" in words
    assert told.removed == found.removed and told.where[0].depends_on == "angle"
    assert all(finite(row.after) < finite(row.before) for row in told.error)
    document = DiagnosisDocument.of(Diagnosis("unexplained", "Something.", structure=found))
    section, read = structure_section(document, found), structure_section(document, None)
    assert read.tables == section.tables and not read.pictures
    assert len(section.pictures) == len(found.laws[0].tables) and "95 % band" in section.pictures[0].svg
