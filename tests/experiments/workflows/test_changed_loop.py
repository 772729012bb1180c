"""A loop whose readings change: by earlier runs and by their MODEL.json the same is said."""

from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from daq import Dataset, InputError, Rig, parse_rig
from experiments.models import Model, load_model, save_model
from experiments.session import prepare
from experiments.workflows import as_reference, find_change, find_change_since
from tests.support.models import write_model
from tests.support.runs import with_columns
from tests.support.servo_joint import DAMPING, GAIN, servo_run

RIG = parse_rig('[mechanism]\nmodel = "joint1"\nactuated = [1]\n')
SCALE = 0.08


def measured(name: str, seed: int, scale: float = 0.0) -> Dataset:
    """A run with the torque of its loop, its encoder's reading 1 + scale of the angle."""
    run, rng = servo_run(name, seed=seed), np.random.default_rng([seed, 1])
    torque = GAIN * (run["q1_cmd_rad"] - run["q1_rad"]) - DAMPING * np.gradient(run["q1_rad"], 1.0 / run.rate_hz)
    return with_columns(run, q1_rad=(1.0 + scale) * run["q1_rad"], tau1_nm=torque + rng.normal(0.0, 0.01, torque.size))


def scaled_runs() -> list[Dataset]:
    return [measured(f"b{k}", 10 + k, SCALE) for k in range(2)]


@pytest.fixture(scope="module")
def before() -> list[Dataset]:
    return [measured(f"a{k}", k) for k in range(4)]


@pytest.fixture(scope="module")
def model(before: list[Dataset], module_path: Path) -> Model:
    """As it comes from its file."""
    return written(before, RIG, module_path / "model.json")


def written(runs: list[Dataset], rig: Rig, path: Path) -> Model:
    """The model of `runs` with what later ones are compared with, from its file."""
    prepared = prepare(runs, rig)
    bare = load_model(write_model(path, [0.1] * prepared.setup.mechanism.p, structs.asdict(prepared.setup.settings)))
    save_model(as_reference(bare, prepared), path)
    return load_model(path)


def test_a_model_says_of_a_loop_what_its_runs_say(before: list[Dataset], model: Model) -> None:
    assert {one.effect for one in model.reference.law} >= {"encoder_scale"}
    scaled = scaled_runs()
    answers = [find_change(scaled, before, RIG).change, find_change_since(scaled, model, "model.json", RIG).change]
    for found in answers:
        cause = found.causes[0]
        assert cause.effect == "encoder_scale" and cause.size[0].value == pytest.approx(SCALE, rel=0.1)
        assert "by the law of the loop" in found.sentence
    assert answers[0].causes[0].size == answers[1].causes[0].size
    same = [measured(f"c{k}", 20 + k) for k in range(2)]
    assert find_change_since(same, model, "model.json", RIG).change.verdict == "no_change"


def test_a_model_of_an_earlier_version_has_no_law(model: Model, tmp_path: Path) -> None:
    assert model.reference is not None
    old = structs.replace(model, reference=structs.replace(model.reference, law=()))
    save_model(old, tmp_path / "old.json")
    found = find_change_since(scaled_runs(), load_model(tmp_path / "old.json"), "old.json", RIG).change
    assert "by the law of the loop" not in found.sentence


def test_a_model_of_a_servo_without_a_measured_torque_is_a_reference_too(model: Model, tmp_path: Path) -> None:
    """Its library has a shape that only joints behind a law have; a model that forgot these joints was refused."""
    rig = parse_rig(f'[mechanism]\nmodel = "joint1"\nactuated = [1]\n[servo]\ngain = {GAIN}\ndamping = {DAMPING}\n')
    runs = [servo_run(f"a{k}", seed=k) for k in range(4)]
    later = [with_columns(run, q1_rad=(1.0 + SCALE) * run["q1_rad"])
             for run in (servo_run(f"b{k}", seed=10 + k) for k in range(2))]
    known = written(runs, rig, tmp_path / "servo.json")
    by_runs, by_model = find_change(later, runs, rig).change, find_change_since(later, known, "servo.json", rig).change
    assert by_runs.verdict == by_model.verdict == "named"
    assert by_runs.causes[0].effect == by_model.causes[0].effect
    with pytest.raises(InputError, match="gives the torque of other joints"):
        find_change_since(later, model, "model.json", rig)
