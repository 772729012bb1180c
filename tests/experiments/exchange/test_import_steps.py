"""An import as a user goes through it: what is shown, asked, written and repeated, and where users hesitated."""

import re
from pathlib import Path

import numpy as np
import pytest

from daq.runs import read_csv
from experiments.judge import number
from tests.support.driven_joint import record as joint_log
from tests.support.imported_files import guess, table
from tests.support.motions import pendulum
from tests.support.mujoco_leg import Leg, record
from tests.support.ros_bag import Bag, header, made
from tests.support.shell import Answers, Shell, typed


@pytest.fixture
def files(tmp_path: Path) -> list[str]:
    """Two logs of a joint that swings, and one without its angle."""
    made = [joint_log(tmp_path / f"log{k}.csv", unit=np.pi / 180) for k in range(2)]
    (tmp_path / "other.csv").write_text("time,effort\n" + "".join(f"{0.01 * k},{k}\n" for k in range(50)))
    return [str(path) for path in (*made, tmp_path / "other.csv")]


def test_it_shows_each_file_and_the_command_that_imports(files: list[str], here: Path,
                                                         shell: Shell) -> None:
    out = here / "runs"
    shell("import", *files, "--out runs")
    said = shell.out
    rows = {line.split()[0]: line.split() for line in said.splitlines() if line.startswith(str(here))}
    assert rows[files[0]][1:5] == ["3000", "200", "15.0", "0.0"]
    assert "has no column 'pos'" in said and said.splitlines()[-1] == (
        f"then: legid import {' '.join(files)} --map runs/columns.toml --out runs")
    assert sorted(p.name for p in out.iterdir()) == ["columns.html", "columns.toml"]


def test_the_command_that_it_names_works_next_to_the_logs(files: list[str], here: Path,
                                                         shell: Shell) -> None:
    """A log that is a CSV would be written onto itself."""
    shell("import log0.csv --map columns.toml --guess")
    shell(shell.out.splitlines()[-1].removeprefix("then: legid "))
    assert read_csv(here / "runs/log0.csv").columns["q1_rad"].size == 3000


@pytest.mark.parametrize("answer, imported", [("y", True), ("n", False), ("", False)])
def test_it_asks_a_person(answer: str, imported: bool, files: list[str], here: Path, answers: Answers) -> None:
    answers(answer)
    typed("import", *files[:2], "--out runs")
    assert sorted(p.name for p in (here / "runs").glob("*.csv")) == (["log0.csv", "log1.csv"] if imported else [])


def test_yes_imports_and_can_be_repeated(files: list[str], here: Path) -> None:
    for _ in range(2):
        typed("import", *files[:2], "--out runs --yes")
    run = read_csv(here / "runs/log1.csv").columns
    assert np.abs(run["q1_rad"]).max() == pytest.approx(1.6, abs=0.2) and run["q1_rad"].size == 3000


def test_a_map_that_was_edited_is_used_without_a_question(files: list[str], here: Path,
                                                          shell: Shell) -> None:
    out = here / "runs"
    out.mkdir()
    (out / "columns.toml").write_text('[columns.q1_rad]\nname = "pos"\n[columns.tau1_nm]\nname = "effort"\n'
                                      '[columns.time_s]\nname = "time"\n')
    shell("import", files[0], "--out runs")
    assert "map: runs/columns.toml" in shell.out
    assert np.abs(read_csv(out / "log0.csv").columns["q1_rad"]).max() > 50.0  # as the map says: not in degrees


def swinging(rate_hz: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) [s] and the angle (n,) [rad] of a pendulum that whirls slower and slower, then swings."""
    t = np.arange(0.0, 20.0, 1.0 / rate_hz)
    return t, pendulum(t, lambda _: 0.0, 0.1, 9.0, (0.15, 0.0), 10.0)


def test_a_wrap_shows_the_unit_and_a_name_keeps_its_backslash(tmp_path: Path,
                                                              shell: Shell) -> None:
    t, q = swinging()
    degrees = (np.degrees(q) + 180.0) % 360.0 - 180.0
    column = guess(table(tmp_path / "a.csv", {"t": t, r"$\theta$": degrees, "u": np.sin(t)}))["q1_rad"]
    assert (column.name, column.unit) == (r"$\theta$", "deg") and r'"$\\theta$"' in (tmp_path / "a.toml").read_text()
    assert "'u' may drive a joint" in shell.err


def test_steps_of_time_are_no_times(here: Path, shell: Shell) -> None:
    t, q = swinging(25.0)
    elapsed = 40.0 + np.random.default_rng(1).integers(-1, 2, t.size)
    table(here / "a.csv", {"position": q, "elapsed": elapsed})
    said = shell.fails("import a.csv --guess --map c.toml")
    assert "'elapsed' is the step from row to row, 40 in the median; give the rate by --rate HZ" in said


def test_two_links_of_which_the_first_has_a_motor_are_a_chain(here: Path) -> None:
    t, q = swinging()
    table(here / "a.csv", {"time_s": t, "q1_rad": q, "q2_rad": 0.1 * q, "tau1_nm": np.sin(t)})
    typed("init rig.toml --from a.csv")
    assert 'model = "chain"' in (here / "rig.toml").read_text()


def test_a_number_of_no_size_is_short() -> None:
    assert number(-5.0e95, 8e90) == "-5e+95"


def bag(folder: Path, coarse: str, empty_efforts: bool) -> Path:
    """Positions and efforts in /joint_states, and once more in topics of their own; `coarse` ("joint_states" or "raw")
    has the torque with errors of half its size."""
    run = record(Leg(), 21, seconds=10.0)
    rough = run["tau2_nm"] + 0.5 * np.std(run["tau2_nm"]) * np.random.default_rng(3).standard_normal(len(run))
    efforts = {"joint_states": (rough, run["tau2_nm"]), "raw": (run["tau2_nm"], rough)}[coarse]
    with Bag(folder) as bag:
        for k, time_s in enumerate(run.time_s):
            bag.put("/joint_states", time_s, made(
                "sensor_msgs/JointState", header(time_s), ["hip", "knee"],
                np.array([run["q1_rad"][k], run["q2_rad"][k]]), np.zeros(0),
                np.array([0.0, 0.0 if empty_efforts else efforts[0][k]])))
            bag.put("/knee_motor/torque", time_s, made("std_msgs/Float64", float(efforts[1][k])))
    return folder


@pytest.mark.parametrize("coarse, empty, torque", [
    ("raw", False, "/joint_states/knee/effort"), ("joint_states", False, "/knee_motor/torque/data"),
    ("joint_states", True, "/knee_motor/torque/data")])
def test_the_better_torque_of_a_bag_is_taken(coarse: str, empty: bool, torque: str, here: Path) -> None:
    target = here / "c.toml"
    typed("import", bag(here / "bag", coarse, empty), "--guess --map c.toml")
    names = dict(re.findall(r'\[columns\.(\w+)\]\nname = "([^"]+)"', target.read_text()))
    assert names["tau2_nm"] == torque and names["q2_rad"] == "/joint_states/knee/position"
    assert (", which may be" in target.read_text() or "may be its torque" in target.read_text()) == (not empty)
