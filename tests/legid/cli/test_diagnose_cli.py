"""`legid diagnose`: documents by the contract, statuses, and what it refuses; the pipeline itself is stood in for."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq import Dataset, load_rig
from estimator import Diagnosis
from estimator.effects import StribeckFriction
from estimator.model import leg2
from experiments.emulation import EFFECTS, NOTHING, LegBody, record_emulated
from experiments.emulation.hidden_effects import LatePivot
from experiments.emulation.plant import LegPlant
from experiments.excite import random_multisine
from experiments.models import load_model
from tests.support.diagnoses import synthetic
from tests.support.imported_files import table_of
from tests.support.models import LEG, write_model
from tests.support.mujoco_leg import Leg, record
from tests.support.paths import DEMO_RIG as RIG
from tests.support.runs import without
from tests.support.shell import Shell, document, read_json

Diagnosed = Callable[..., dict[str, Any]]


def run_csv(path: Path, seed: int, *left_out: str) -> Path:
    """Six seconds of a leg without these columns."""
    return table_of(without(record(Leg(), seed, seconds=6.0), *left_out), path)


@pytest.fixture(scope="module")
def runs(module_path: Path) -> list[Path]:
    return [run_csv(module_path / f"r{k}.csv", k) for k in (1, 2, 3, 4)]


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text('[mechanism]\nmodel="leg2"\nactuated=[2]\n[imu]\nlever_arm_m=0.2\n[motor]\ngear_ratio=50\n'
                    '[sampling]\nhold="zero"\n')
    return path


@pytest.fixture
def diagnosed(runs: list[Path], rig: Path, shell: Shell, monkeypatch: pytest.MonkeyPatch) -> Diagnosed:
    """Types a diagnosis whose pipeline returns what it is given; the answer is what the pipeline was asked."""
    def typed(found: Diagnosis, *words: object, files: Sequence[Path] = runs, status: int = 0) -> dict[str, Any]:
        asked: dict[str, Any] = {}

        def stand_in(datasets: Sequence[Dataset], mechanism: object, options: object, **more: Any) -> Diagnosis:
            asked.update(more, datasets=datasets, options=options)
            more["progress"]("a stage", 0.5)
            return found

        monkeypatch.setattr("experiments.workflows.diagnose.diagnose", stand_in)
        shell("diagnose", *files, "--rig", rig, *words, status=status)
        return asked

    return typed


def extended() -> Diagnosis:
    """The synthetic finding with what a saved model needs."""
    beta = np.array(LegBody().beta())
    return replace(synthetic(), effects=((StribeckFriction(1), np.array([0.05, 0.2, 2.0])),),
                   extended_beta=np.concatenate([beta, [0.05, 0.2, 2.0]]), extended_covariance=1e-8 * np.eye(12),
                   noise={"torque_nm": 0.02}, mechanism=leg2(velocity_scale=(0.005, 0.04)),
                   angle_range=np.array([[-0.5, 0.4], [-1.0, 1.25]]))


def test_what_is_written_and_said(runs: list[Path], diagnosed: Diagnosed, tmp_path: Path, shell: Shell) -> None:
    asked = diagnosed(extended(), "--json", tmp_path / "d.json", "--html", tmp_path / "d.html", "--model-out",
                      tmp_path / "m.json", "--seed 7")
    assert shell.out.startswith(synthetic().sentence)
    assert read_json(tmp_path / "d.json")["schema"] == "legid.diagnosis/1"
    assert "<h2>Causes</h2>" in (tmp_path / "d.html").read_text()
    model = load_model(tmp_path / "m.json")
    (effect,) = model.effects
    assert (effect.name, effect.joint) == ("stribeck_friction", 2)
    assert effect.sizes == {"excess_torque": 0.05} and effect.shapes == {"stribeck_velocity": 0.2, "exponent": 2.0}
    assert model.gear_ratio == 50.0 and model.hold == "zero" and model.provenance.runs == ("r1.csv", "r3.csv", "r2.csv")
    assert model.mechanism.friction_velocity_radps == (0.005, 0.04)
    assert model.reach == ((-0.5, 0.4), (-1.0, 1.25))
    assert asked["seed"] == 7 and asked["gear_ratio"] == 50.0 and asked["reference"] is None
    assert [d.name for d in asked["datasets"]] == [path.name for path in runs]


@pytest.mark.parametrize("output", ["--json", "--html", "--model-out"])
def test_a_full_disk_does_not_take_the_diagnosis_with_it(output: str, diagnosed: Diagnosed, shell: Shell) -> None:
    diagnosed(extended(), output, "/dev/full", status=2)
    said = shell.read()
    assert said.out.startswith(synthetic().sentence)
    assert said.err.splitlines()[-1] == ("legid diagnose: /dev/full: No space left on device; free space there, or "
                                         "give another place")


def test_the_pivots_encoder_is_not_read_with_an_imu(diagnosed: Diagnosed, tmp_path: Path) -> None:
    asked = diagnosed(synthetic())
    assert asked["options"].sensors == "imu" and all("q1_rad" not in d for d in asked["datasets"])
    hall = [run_csv(tmp_path / f"h{k}.csv", k, "gyro_radps", "accel_x_mps2", "accel_y_mps2") for k in (1, 2)]
    asked = diagnosed(synthetic(), files=hall)
    assert asked["options"].sensors == "encoder" and all("q1_rad" in d for d in asked["datasets"])


def test_a_nominal_model_is_saved_where_nothing_was_found(diagnosed: Diagnosed, tmp_path: Path) -> None:
    diagnosed(replace(synthetic(), verdict="none", causes=(), extended={}), "--model-out", tmp_path / "m.json")
    model = load_model(tmp_path / "m.json")
    assert model.effects == () and model.beta == [0.1] * 9 and model.covariance[0][0] == pytest.approx(1e-6)
    asked = diagnosed(synthetic(), "--reference", tmp_path / "m.json")
    assert asked["reference"]["beta4"] == (0.1, pytest.approx(1e-3))


def test_a_reference_with_terms_that_a_fit_chose_is_taken_for_the_same_rig(diagnosed: Diagnosed, tmp_path: Path
                                                                          ) -> None:
    path = write_model(tmp_path / "chosen.json", [0.1] * 10, {**LEG, "torque_offset": (2,)})
    asked = diagnosed(synthetic(), "--reference", path)
    assert asked["reference"]["torque_offset_2"] == (0.1, 0.0)


def test_a_fit_that_fails_says_that_the_reference_was_not_compared(diagnosed: Diagnosed, tmp_path: Path, shell: Shell
                                                                  ) -> None:
    path = write_model(tmp_path / "m.json", [0.1] * 9, LEG)
    diagnosed(Diagnosis("fit_failed", "No diagnosis: the fit did not converge."), "--reference", path, status=1)
    (said,) = shell.err.splitlines()
    assert "The reference was not compared: that needs a fit of these runs." in said


def test_a_failed_fit_writes_its_json_and_ends_with_one(runs: list[Path], rig: Path, here: Path,
                                                        shell: Shell) -> None:
    # No stand-in: six seconds are too little for the pipeline itself.
    found = document("diagnose", runs[0], "--rig", rig, "--html d.html --model-out m.json", status=1)
    assert found["verdict"] == "fit_failed" and "6.0 s" in found["sentence"] and found["causes"] == []
    error = shell.read()
    assert error.err.count("\n") == 1 and found["sentence"].rstrip(".") in error.err and error.out == ""
    assert (here / "d.html").exists() and not (here / "m.json").exists()


def test_runs_that_do_not_belong_together(runs: list[Path], rig: Path, here: Path, shell: Shell) -> None:
    other = run_csv(here / "other.csv", 9)
    other.write_text(other.read_text().replace("gyro_radps", "gyro"))
    copy = here / "copy"
    copy.mkdir()
    (copy / runs[0].name).write_text(runs[0].read_text())
    model = here / "m.json"
    model.write_text("{}")
    for args, says in (([*runs, other], "other.csv"), ([*runs, copy / runs[0].name], "given twice"),
                       ([*runs, "none.csv"], "none.csv"), ([*runs, "--reference", model], "m.json"),
                       ([*runs, "--seed -1"], "whole number")):
        assert says in shell.fails("diagnose", *args, "--rig", rig, "--json d.json")
    assert not (here / "d.json").exists()


def test_native_runs_of_different_rigs(demo_run: Path, here: Path, shell: Shell) -> None:
    text, other = RIG.read_text().replace("lever_arm_m = 0.20", "lever_arm_m = 0.15"), here / "b.mcap"
    assert text != RIG.read_text()
    record_emulated(other, load_rig(RIG), text, random_multisine(1, 4.0, 0.3), 1)
    said = shell.fails("diagnose", demo_run, "b.mcap --rig", RIG)
    assert f"b.mcap: was recorded on another rig than {demo_run.name}" in said


# -- what an emulated leg hides ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["stribeck_friction", "asymmetric_friction", "rotor_inertia", "joint_stiffness",
                                  "quadratic_drag"])
def test_hidden_effects_change_the_motion(name: str) -> None:
    plain, other = NOTHING.plant(LegBody()), EFFECTS[name].plant(LegBody())
    for torque in random_multisine(2, 5.0, 0.6).torque_nm:
        a, b = plain.step(0.01, torque), other.step(0.01, torque)
    assert max(abs(a.q1 - b.q1), abs(a.q2 - b.q2), abs(a.q1d - b.q1d), abs(a.q2d - b.q2d)) > 1e-2


@pytest.mark.parametrize("make, torque, moves", [
    *((EFFECTS["stribeck_friction"].plant, *case) for case in ((0.099, False), (0.101, True))),
    *((LegPlant, *case) for case in ((0.069, False), (0.071, True), (-0.039, False), (-0.041, True)))])
def test_friction_at_standstill_holds_up_to_its_level_by_direction(make: Callable[[LegBody], LegPlant], torque: float,
                                                                   moves: bool) -> None:
    plant = make(LegBody(coulomb=(5.0, 0.04), forward_coulomb=(0.0, 0.03 * (make is LegPlant))))
    for _ in range(100):
        state = plant.step(5e-4, torque)
    assert (state.q2 != 0.0) is moves


def test_stribeck_friction_falls_with_speed() -> None:
    body = LegBody(stribeck=(0.0, 0.06), stribeck_radps=0.25)
    assert body.friction(1, 1, 0.0) == pytest.approx(0.10) and body.friction(1, -1, 0.25) == pytest.approx(0.07)


def test_a_late_pivot_shows_what_was() -> None:
    plain, late = LegPlant(), LatePivot(LegPlant(), 0.004)
    states = [plain.step(5e-4, 0.3) for _ in range(40)]
    seen = [late.step(5e-4, 0.3) for _ in range(40)]
    assert seen[30].q1 == states[22].q1 and seen[30].q1dd == states[22].q1dd and seen[30].q2 == states[30].q2
