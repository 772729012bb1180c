"""Ways of a new user that once ended without a next step."""

from pathlib import Path

import numpy as np

import legid
from tests.support.driven_pendulum import pendulum_run
from tests.support.imported_files import table
from tests.support.paths import FIXTURES
from tests.support.shell import Shell, typed

RIG = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n[sampling]\nrate_hz = 50.0\n'


def written(folder: Path, **columns: np.ndarray) -> Path:
    (folder / "rig.toml").write_text(RIG)
    return table(folder / "run.csv", columns)


def test_a_commanded_angle_asks_for_its_servo(here: Path, shell: Shell) -> None:
    run = pendulum_run("r", 1)
    file = written(here, time_s=run.time_s, q1_rad=run["q1_rad"], q1_cmd_rad=run["q1_rad"])
    said = shell.fails("fit", file, "--rig rig.toml")
    assert "declare the servo that q1_cmd_rad commands by [servo]" in said and "actuated" not in said


def test_a_run_is_a_plan_by_its_measured_torque_and_a_model_prints_short(here: Path,
                                                                         shell: Shell) -> None:
    run = pendulum_run("r", 2)
    file = written(here, time_s=run.time_s, q1_rad=run["q1_rad"], tau1_nm=run["tau1_nm"])
    model, out = here / "m.json", here / "out.csv"
    shell("fit", file, "--rig rig.toml --model-out m.json")
    shell("simulate m.json --plan", file, "--out out.csv")
    made = np.genfromtxt(out, delimiter=",", names=True)
    assert np.std(made["q1_rad"] - run["q1_rad"][:made.size]) < 0.2 * np.std(run["q1_rad"])
    text = str(legid.load_model(model))
    assert text.startswith("joint1, fitted by mle to run.csv\nbeta1 = 0.05") and len(text) < 400


def test_a_folder_of_csv_files_is_listed(here: Path, shell: Shell) -> None:
    run = pendulum_run("r", 3)
    written(here, time_s=run.time_s, q1_rad=run["q1_rad"], tau1_nm=run["tau1_nm"])
    (here / "plan.csv").write_text("time_s,tau2_cmd_nm\n0,0\n1,0\n")
    shell("runs", here)
    out = shell.out
    assert "run.csv" in out and "plan.csv" not in out and "1 runs" in out
    (here / "logs").mkdir()
    (here / "logs/a.csv").write_text("t,angle\n0,0\n1,0\n")
    shell("runs logs")
    assert "1 CSV files of other programs: legid import" in shell.out
    shell("runs", here)
    out = shell.out
    assert "1 CSV files of other programs: legid import" in out and "1 runs" in out


def test_a_native_run_is_a_plan_by_its_measured_torque(here: Path) -> None:
    typed("fit", FIXTURES / "healthy.mcap", "--model-out m.json")
    typed("simulate m.json --plan", FIXTURES / "healthy.mcap", "--out out.csv")
    made, run = np.genfromtxt(here / "out.csv", delimiter=",", names=True), legid.load(FIXTURES / "healthy.mcap")
    known = run["tau2_nm"][np.isfinite(run["tau2_nm"])]
    np.testing.assert_allclose(made["tau2_cmd_nm"][:100], known[:100], rtol=1e-6)
