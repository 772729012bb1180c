"""MODEL.json: what is written reads back; anything else is refused with the place named."""

import json
import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from daq import InputError, parse_rig
from estimator import RunAgreement
from estimator.model import leg2
from experiments.judge import model_of
from experiments.models import (
    MechanismSettings,
    Model,
    build_mechanism,
    load_model,
    mechanism_settings,
    save_model,
    widening_of,
)
from experiments.reports.fit_text import noise_rows
from experiments.session.setup import choose_sensors
from experiments.workflows.compare import parameter_pairs
from tests.support.fits import document_of, synthetic_fit
from tests.support.paths import ROOT
from tests.support.shell import read_json

RIG = parse_rig('[mechanism]\nmodel="leg2"\nactuated=[2]\n[imu]\nlever_arm_m=0.2')


def leg_model() -> Model:
    return model_of(synthetic_fit(), mechanism_settings(RIG), "linear", ["a.csv"], datetime(2026, 1, 2, tzinfo=UTC))


def test_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    save_model(leg_model(), path)
    assert load_model(path) == leg_model()
    document = read_json(path)
    assert document["schema"] == "legid.model/1" and document["effects"] == []
    assert document["mechanism"]["actuated"] == [2]
    assert document["provenance"]["date"] == "2026-01-02T00:00:00+00:00"


def test_levels_of_axes_and_joints_are_kept_with_the_common_one() -> None:
    levels = {"torque_nm": 0.03, "torque1_nm": 0.01, "torque2_nm": 0.03, "gyro_radps": 0.005, "accel_mps2": 0.05,
              "accel_x_mps2": 0.03, "accel_y_mps2": 0.064, "accel_correlation": -0.4}
    result = replace(synthetic_fit(), noise=levels)
    assert document_of(result).document["noise"] == {
        "torque_nm": 0.03, "torque_nm_by_joint": [0.01, 0.03], "gyro_radps": 0.005, "accel_mps2": 0.05,
        "accel_mps2_by_axis": [0.03, 0.064], "accel_correlation": -0.4}
    assert [row[:2] for row in noise_rows(document_of(result))] == [
        ["torque 1", "0.01"], ["torque 2", "0.03"], ["gyro", "0.005"], ["accelerometer x", "0.03"],
        ["accelerometer y", "0.064"], ["their correlation, as given", "-0.4"]]


def test_a_model_keeps_what_correlates(tmp_path: Path) -> None:
    for value in (-0.4, 1.0):
        noise = {**leg_model().noise, "accel_correlation": value}
        save_model(msgspec.structs.replace(leg_model(), noise=noise), tmp_path / f"{value}.json")
    assert load_model(tmp_path / "-0.4.json").noise["accel_correlation"] == -0.4
    with pytest.raises(InputError, match="accel_correlation that is not between -1 and 1"):
        load_model(tmp_path / "1.0.json")


def test_mechanism_comes_back_with_its_settings() -> None:
    settings = mechanism_settings(parse_rig(
        '[mechanism]\nmodel="leg2"\nactuated=[1,2]\ngravity_mps2=9.8\n[imu]\nlever_arm_m=0.11\n'
        '[terms]\nrotor_inertia=[2]\ntorque_offset=[2]\nfriction_velocity_radps=0.02'))
    mechanism = build_mechanism(settings)
    assert mechanism.actuated == (0, 1) and mechanism.lever_arm == 0.11 and mechanism.gravity == 9.8
    assert mechanism.names[-2:] == ("rotor_inertia_2", "torque_offset_2") and mechanism.velocity_scale == 0.02


def test_friction_is_rounded_off_over_one_speed_where_nothing_is_said() -> None:
    """In a rig file, a model file and the estimator, as the page states."""
    stated = re.search(r"friction_velocity_radps = (\S+)", (ROOT / "docs/rig.md").read_text())
    rig = mechanism_settings(parse_rig('[mechanism]\nmodel="leg2"\nactuated=[2]')).friction_velocity_radps
    model = MechanismSettings(model="leg2", actuated=(2,)).friction_velocity_radps
    assert rig == model == leg2().velocity_scale == float(stated.group(1))


@pytest.mark.parametrize("settings, what", [
    (MechanismSettings(model="leg2", actuated=(3,)), "above 2"),
    (MechanismSettings(model="leg2", actuated=(2,), input="voltage"), "voltage"),
    (MechanismSettings(model="joint1", actuated=(1,), rotor_inertia=(1,)), "rotor_inertia"),
    (MechanismSettings(model="biped3", actuated=(2, 3), torque_offset=(2,)), "torque_offset"),
])
def test_mechanisms_that_cannot_be(settings: MechanismSettings, what: str) -> None:
    with pytest.raises(ValueError, match=what):
        build_mechanism(settings)


def test_unknown_variance_is_null(tmp_path: Path) -> None:
    result = synthetic_fit()
    result.covariance[8, 8] = np.inf
    model = model_of(result, mechanism_settings(RIG), "zero", [])
    save_model(model, tmp_path / "m.json")
    assert load_model(tmp_path / "m.json").covariance[8][8] is None


def test_intervals_that_runs_widened_are_kept(tmp_path: Path) -> None:
    """By the covariance alone they would be narrower: Student's quantile is in no matrix."""
    plain = synthetic_fit()
    p = plain.std.size
    agreement = RunAgreement(("a", "b"), 1e-4, plain.std / 2.0, True, np.full(p, 4.0))
    wide = replace(plain, agreement=agreement, at_bound={"beta9": 0.5})
    save_model(model_of(wide, mechanism_settings(RIG), "zero", []), tmp_path / "wide.json")
    save_model(model_of(plain, mechanism_settings(RIG), "zero", []), tmp_path / "plain.json")
    kept, without = load_model(tmp_path / "wide.json"), load_model(tmp_path / "plain.json")
    assert np.array(kept.ci95) == pytest.approx(wide.ci95()) and without.ci95 == ()
    assert widening_of(kept)[:8] == pytest.approx([4.0 / 1.959964] * 8) and widening_of(without) == [1.0] * p
    pairs = parameter_pairs((kept, without))
    for k, pair in enumerate(pairs):
        assert (pair.a.low, pair.a.high) == pytest.approx(wide.ci95()[k])
        assert pair.b.high - pair.b.low == pytest.approx(2 * 1.959964 * plain.std[k])


def changed(value: Any, *path: Any) -> str:
    """The model's file with another value at this place."""
    at = whole = json.loads(msgspec.json.encode(leg_model()))
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return json.dumps(whole)


@pytest.mark.parametrize("content, place", [
    ("", "not JSON"), ("{", "not JSON"), ("[]", "expected `object`"), ("\x80", "not JSON"), ("{}", "schema"),
    (changed("legid.model/9", "schema"), "schema"),
    (changed("spider", "mechanism", "model"), "mechanism.model"),
    (changed("big", "parameters", 3, "value"), "parameters[3].value"),
    (changed(None, "parameters", 3, "value"), "parameters[3].value"),
    (changed([], "parameters"), "parameters"),
    (changed("beta2", "parameters", 0, "name"), "parameters"),
    (changed([[1.0]], "covariance"), "9 by 9"),
    (changed([[0.0, 1.0]], "ci95"), "ci95"),
    (changed(-1.0, "noise", "gyro_radps"), "noise"),
    (changed([7], "mechanism", "actuated"), "above 2"),
    (changed("cubic", "hold"), "hold"),
    (changed(1, "surprise"), "surprise"),
    (changed(12345.5, "parameters", 3, "value").replace("12345.5", "1e999"), "parameters"),
    ('{"schema": ' + "[" * 100_000, "schema"), ('{"a": ' * 100_000, "unknown field"),
])
def test_bad_files_are_refused_in_one_line(tmp_path: Path, content: str, place: str) -> None:
    path = tmp_path / "model.json"
    path.write_text(content, encoding="latin-1")
    with pytest.raises(InputError, match=rf"^{re.escape(str(path))}.*{re.escape(place)}.*\Z"):  # . is no new line
        load_model(path)


def test_fit_document_is_the_contract() -> None:
    found = document_of(synthetic_fit()).document
    first = {"schema", "model", "method", "sensors", "parameters", "noise", "torque_residual_rms_nm", "converged",
             "iterations", "samples", "wall_s"}
    assert first <= set(found) and found["schema"] == "legid.fit/1" and found["model"] == "leg2"
    assert [p["name"] for p in found["parameters"]] == [f"beta{k}" for k in range(1, 10)]
    assert [p["unit"] for p in found["parameters"]] == ["kg m^2"] * 3 + ["kg m"] * 2 + ["N m s/rad"] * 2 + ["N m"] * 2
    p = found["parameters"][0]
    assert p["meaning"] == "I1 + m1*lc1^2 + m2*l1^2"
    assert p["ci95"] == pytest.approx([p["value"] - 1.959964 * p["std"], p["value"] + 1.959964 * p["std"]])


def test_sensors_follow_the_columns() -> None:
    class Run(dict[str, object]):
        name = "r"

    imu = Run.fromkeys(["gyro_radps", "accel_x_mps2", "accel_y_mps2", "q1_rad"])
    hall = Run.fromkeys(["q1_rad"])
    pick: Any = choose_sensors
    assert pick(RIG, [imu, imu], None) == "imu"
    assert pick(RIG, [imu, hall], None) == "encoder"
    assert pick(RIG, [imu], "encoder") == "encoder"
    with pytest.raises(InputError, match="no IMU columns"):
        pick(RIG, [hall], "imu")
    with pytest.raises(InputError, match="q1_rad"):
        pick(RIG, [Run.fromkeys(["gyro_radps", "accel_x_mps2", "accel_y_mps2"]), hall], None)
