"""A walker's records by the commands: fitted over steps, validated across touchdowns, diagnosed, or refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq import Dataset
from daq.runs import write_csv
from tests.support.shell import Shell, document, read_json, typed
from tests.support.walker_plant import RIG, Gait, Law, Plant, Walker, no_loss, record, walk

GEARED = RIG + "[motor]\ngear_ratio = 20.0\n"


def put(folder: Path, seed: int, steps: int, stance: bool, loss: Law = no_loss) -> Path:
    rng = np.random.default_rng(seed)
    path = folder / f"walk{seed}.csv"
    write_csv(record(path.name, walk(Plant(Walker(), loss), Gait(), steps, rng, 100.0, 4), rng, stance=stance), path)
    return path


@pytest.fixture(scope="module")
def folder(module_path: Path) -> Path:
    (module_path / "rig.toml").write_text(GEARED)
    put(module_path, 2, 12, False)
    put(module_path, 3, 12, True)
    return module_path


@pytest.fixture(scope="module")
def model(folder: Path) -> Path:
    out = folder / "model.json"
    typed("fit", folder / "walk2.csv", "--rig", folder / "rig.toml", "--json", folder / "fit.json", "--model-out", out)
    return out


def test_a_record_without_contacts_is_fitted_over_its_steps(folder: Path, model: Path) -> None:
    found = read_json(folder / "fit.json")
    assert found["converged"] and not found["undetermined"]
    assert any(text.startswith("walk2.csv: 11 touchdowns, as its angles show, to ") for text in found["assumptions"])
    for p, true in zip(found["parameters"], Walker().beta):
        assert abs(p["value"] - true) < 4.0 * p["std"] < 0.3 * true
    assert read_json(model)["mechanism"]["hips"] is True


def test_free_runs_go_on_until_they_fall(folder: Path, model: Path, shell: Shell) -> None:
    found = document("validate", model, folder / "walk3.csv", "--rig", folder / "rig.toml", "--html", folder / "v.html")
    text, walked = shell.out, found["walk"]
    assert "all fell" in text and "falls after" in text and "later steps are not compared" in text
    assert "across touchdowns" in (folder / "v.html").read_text()
    first, last = walked["ahead"][0], walked["ahead"][-1]
    assert first["fell"] == 0 and first["pieces"] == 12 and 0.0 < first["rmse"]["q1_rad"] < 0.1
    assert last["fell"] == last["pieces"] and set(last["rmse"].values()) == {None}
    assert walked["runs"][0]["fell_s"] > 1.0 and 1 < walked["runs"][0]["fell_in_step"] < 12


def test_a_plan_alone_keeps_no_walker_up(folder: Path, model: Path, shell: Shell) -> None:
    plan = folder / "plan.csv"
    plan.write_text("time_s,tau2_cmd_nm\n0,1\n0.1,1\n")
    said = shell.fails("simulate", model, "--plan", plan, "--out", folder / "x.csv")
    assert "is a walker, which falls under a plan" in said


@pytest.mark.parametrize("change, said", [
    ("stance", "column stance never changes from one leg to the other"),
    ("still", "no touchdown stands out of the angles' noise; give a column stance"),
])
def test_a_record_that_cannot_be_cut_is_refused(folder: Path, shell: Shell, change: str, said: str) -> None:
    count, rng = 400, np.random.default_rng(0)
    columns = {name: 1e-3 * rng.normal(size=count) for name in ("q1_rad", "q2_rad", "q3_rad", "tau2_nm", "tau3_nm")}
    data = Dataset(f"{change}.csv", 100.0, np.arange(count) / 100.0, columns)
    if change == "stance":
        data = replace(data, columns=columns | {"stance": np.ones(count)})
    path = folder / data.name
    write_csv(data, path)
    assert said in shell.fails("fit", path, "--rig", folder / "rig.toml", status=1)


def test_only_a_biped_walks(here: Path, shell: Shell) -> None:
    rig = here / "rig.toml"
    rig.write_text('[mechanism]\nmodel = "leg2"\nactuated = [2]\n[walker]\n')
    assert "[walker]: that is for a biped3" in shell.fails("fit rig.toml --rig rig.toml")
    rig.write_text('[mechanism]\nmodel = "biped3"\nactuated = [2, 3]\n[walker]\n[[imu]]\nlink = 3\n')
    assert "[walker]: that is for a biped3 without distance_meter or imu" in shell.fails("fit rig.toml --rig rig.toml")


@pytest.mark.slow
def test_a_spring_at_one_leg_is_named_there(folder: Path) -> None:
    """Half a minute."""
    def spring(leg: int, angle: float, rate: float, torque: float) -> float:
        return 8.0 * angle if leg == 1 else 0.0

    runs = [put(folder, seed, 6, True, spring) for seed in range(20, 28)]
    found = document("diagnose", *runs, "--rig", folder / "rig.toml", "--workers 1")
    cause, = found["causes"]
    assert (found["verdict"], cause["effect"], cause["joint"]) == ("named", "joint_stiffness", 3)
    low, high = cause["size"][0]["ci95"]
    assert low < 8.0 < high
