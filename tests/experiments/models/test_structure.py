"""A model with a structure is a model: saved, read, simulated and validated; an independent plant judges it."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import legid
from daq import InputError
from daq.recording import read_plan
from estimator import Diagnosis
from experiments.documents import DiagnosisDocument, finite, learnt_of
from experiments.emulation.hidden_effects import REST_RAD, SPRING_NM
from experiments.models import Model, TorqueTable, load_model, save_model, structure_values
from experiments.models.schema import JointTorque, StructureValues, TableInput
from experiments.models.structure import laws_of
from experiments.reports.structure import structure_section, structure_words
from tests.support.extended_models import assert_moves_as_the_plant, model_with, noisy_run, run_of
from tests.support.learnt import hidden_magnet
from tests.support.shell import Shell, document

SPRING = TorqueTable(inputs=(TableInput(variable="angle", joint=2),), knots=((-2.0, 2.0),), std=(0.001, 0.001),
                     values=(SPRING_NM * (-2.0 - REST_RAD), SPRING_NM * (2.0 - REST_RAD)))


def with_table(table: TorqueTable) -> Model:
    torque = JointTorque(joint=2, constant=0.0, tables=(table,), noise_nm=0.01)
    structure = StructureValues(torques=(torque,), removed=0.5, removed_ci95=(0.4, 0.6))
    return msgspec.structs.replace(model_with(), structure=structure)


def test_it_is_saved_and_read_and_old_files_have_none(tmp_path: Path) -> None:
    model = with_table(SPRING)
    save_model(model, tmp_path / "m.json")
    assert load_model(tmp_path / "m.json") == model
    document = json.loads((tmp_path / "m.json").read_text())
    del document["structure"]
    (tmp_path / "m.json").write_text(json.dumps(document))
    assert load_model(tmp_path / "m.json").structure is None and laws_of(load_model(tmp_path / "m.json")) == ()


def test_a_learnt_structure_survives_the_file() -> None:
    found = hidden_magnet()
    model = msgspec.structs.replace(model_with(), structure=structure_values(found))
    (law,), (again,) = found.laws, laws_of(model)
    np.testing.assert_array_equal(again.torque(found.samples.at), law.torque(found.samples.at))
    assert model.structure.removed == found.removed


@pytest.mark.parametrize("change, says", [
    ({"knots": [[2.0, -2.0]]}, "do not increase"), ({"values": [1.0]}, "1 values for 2 knots"),
    ({"inputs": []}, "one list of knots"), ({"inputs": [{"variable": "angle", "joint": 3}]}, "joint 3"),
    ({"inputs": [{"variable": "mood", "joint": 1}]}, "mood"), ({"std": [-1.0, 1.0]}, "std"),
])
def test_a_structure_that_cannot_be_run_is_named(change: dict[str, Any], says: str, tmp_path: Path) -> None:
    document = json.loads(msgspec.json.encode(with_table(SPRING)))
    document["structure"]["torques"][0]["tables"][0] |= change
    (tmp_path / "m.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=says):
        load_model(tmp_path / "m.json")


def test_simulation_is_the_motion_of_a_plant_with_that_torque(tmp_path: Path) -> None:
    assert_moves_as_the_plant(with_table(SPRING), "joint_stiffness", tmp_path)


def test_validate_and_compare_use_it(tmp_path: Path) -> None:
    rig = noisy_run(with_table(SPRING), tmp_path)
    model, plain, log = (tmp_path / name for name in ("m.json", "plain.json", "run.csv"))
    (run,) = document("validate", model, log, "--rig", rig, "--horizons 0.5")["runs"]
    assert run["rmse"]["q1_rad"] < 0.01 and run["rmse"]["q2_rad"] < 0.03
    told = document("compare", model, plain, log, "--rig", rig, "--horizons 0.5")
    assert all(row["b"] > 2.0 * row["a"] for row in told["errors"])


def test_a_motion_beyond_its_range_is_told(tmp_path: Path, shell: Shell) -> None:
    narrow = msgspec.structs.replace(SPRING, knots=((-0.05, 0.05),), values=(-0.01, 0.01))
    run_of(with_table(narrow), tmp_path)
    said = shell.err
    assert "angle of joint 2" in said and "leaves the range" in said
    run_of(with_table(SPRING), tmp_path)
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
