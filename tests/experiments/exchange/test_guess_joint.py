"""The guess for a single driven joint: unit of its angle, sign of its torque, and what does not show."""

import json
from pathlib import Path

import numpy as np
import pytest

from daq.runs import read_csv
from experiments.exchange.column_map import load_map
from experiments.models import load_model
from tests.support.driven_joint import record
from tests.support.imported_files import guess, table
from tests.support.shell import Shell, typed

RIG = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n'


@pytest.mark.parametrize("names", [("pos", "effort"), ("joint_angle", "torque"), ("hip", "tau")])
@pytest.mark.parametrize("unit, written", [(1.0, ""), (np.pi / 180, "deg"), (2 * np.pi, "turn")])
@pytest.mark.parametrize("sign", [1, -1])
def test_gravity_shows_the_unit_and_inertia_the_sign(names: tuple[str, str], unit: float, written: str, sign: int,
                                                     tmp_path: Path) -> None:
    found = guess(record(tmp_path / "x.csv", names, unit, sign, 1.0))
    angle, torque = found["q1_rad"], found["tau1_nm"]
    assert (angle.name, angle.unit, torque.name, torque.sign) == (names[0], written, names[1], sign)


def test_a_joint_s_file_goes_to_a_fit(tmp_path: Path) -> None:
    file = record(tmp_path / "x.csv", unit=np.pi / 180, sign=-1)
    (tmp_path / "rig.toml").write_text(RIG)
    guess(file)
    typed("import", file, "--map", tmp_path / "x.toml", "--out", tmp_path / "runs")
    typed("fit", tmp_path / "runs" / "x.csv", "--rig", tmp_path / "rig.toml")


def test_without_gravity_the_unit_is_said_not_to_show(tmp_path: Path, shell: Shell) -> None:
    assert guess(record(tmp_path / "x.csv", gravity=0.0))["q1_rad"].unit == ""
    assert "the unit of 'pos' does not show" in shell.err


def test_a_torque_of_another_machine_is_not_explained(tmp_path: Path, shell: Shell) -> None:
    file = record(tmp_path / "x.csv")
    time, angle, _ = np.loadtxt(file, delimiter=",", skiprows=1).T
    torque = np.random.default_rng(2).normal(size=len(time)).cumsum()
    guess(table(file, {"time": time, "pos": angle, "effort": torque}), status=1)
    assert "explains the torque 'effort'" in shell.err


@pytest.mark.parametrize("unit, written", [(1.0, ""), (np.pi / 180, "deg")])
def test_a_pendulum_that_swings_freely_goes_to_a_fit(unit: float, written: str, tmp_path: Path,
                                                        shell: Shell) -> None:
    """No torque in the file: gravity still shows the unit, and one known number gives the scale."""
    h, q, v = 0.001, 2.5, 0.0
    angles = []
    for _ in range(20_000):
        v -= h * (9.81 * 0.02 * np.sin(q) + 4e-4 * v) / 0.005
        q += h * v
        angles.append(q)
    noise = np.random.default_rng(1).normal(0.0, 5e-4, 2000)
    table(tmp_path / "swing.csv", {"t": np.arange(2000) * 0.01, "theta": (angles[::10] + noise) / unit})
    (tmp_path / "rig.toml").write_text('[mechanism]\nmodel = "joint1"\nactuated = []\n')
    shell("import", tmp_path / "swing.csv", "--out", tmp_path / "runs", "--yes")
    found = load_map(tmp_path / "runs" / "columns.toml")
    assert set(found) == {"time_s", "q1_rad"} and found["q1_rad"].unit == written
    assert "a joint that swings freely" in shell.out
    model = tmp_path / "model.json"
    shell("fit", tmp_path / "runs/swing.csv", "--rig", tmp_path / "rig.toml", "--fix beta2=0.02 --model-out", model)
    assert load_model(model).parameters[0].value == pytest.approx(0.005, rel=0.01)


def test_a_table_without_a_header_is_said_to_have_none(tmp_path: Path, shell: Shell) -> None:
    file = record(tmp_path / "x.csv")
    file.write_text("\n".join(file.read_text().splitlines()[1:]))
    said = shell.fails("import", file, "--guess --map", tmp_path / "c.toml")
    assert "has no header line: its 3 columns have no names" in said


def test_seconds_of_a_record_are_imported_alone(tmp_path: Path, shell: Shell) -> None:
    """A hand holds the pendulum before it is let go."""
    file = record(tmp_path / "x.csv")
    out, columns = tmp_path / "runs", tmp_path / "runs" / "columns.toml"
    shell("import", file, "--out", out, "--yes --span 5,9")
    time_s = read_csv(out / "x.csv").time_s
    assert (time_s[0], time_s[-1]) == (pytest.approx(5.0), pytest.approx(8.995))
    shell.read()
    for wanted, said in (("50,66", "no sample between 50 and 66 s; it goes from 0 to 14.995 s"),
                         ("9,5", "'9,5' is not FROM,TO in seconds"), ("5", "is not FROM,TO")):
        assert said in shell.fails("import", file, "--map", columns, "--out", out, "--span", wanted)


def test_a_span_of_a_record_by_the_calendar_is_said_to_the_millisecond(
        tmp_path: Path, shell: Shell) -> None:
    file, columns = tmp_path / "x.csv", tmp_path / "c.toml"
    file.write_text("t,a\n" + "".join(f"{1.7e9 + k / 100:.2f},{k / 100:.2f}\n" for k in range(100)))
    columns.write_text('[columns.time_s]\nname = "t"\n[columns.q1_rad]\nname = "a"\n')
    call = "import", file, "--map", columns, "--out", tmp_path / "runs", "--span"
    assert "it goes from 1700000000 to 1700000000.99 s" in shell.fails(*call, "0,1")
    shell(*call, "1700000000.1,1700000000.8")


def test_a_file_without_times_needs_a_rate(tmp_path: Path, shell: Shell) -> None:
    file, columns = tmp_path / "x.json", tmp_path / "c.toml"
    file.write_text(json.dumps({"rate": 50, "data": {"angles": [k / 100 for k in range(100)]}}))
    columns.write_text('[columns.q1_rad]\nname = "data.angles"\n')
    call = "import", file, "--map", columns, "--out", tmp_path / "runs"
    assert "has no times" in (said := shell.fails(*call)) and "--rate" in said
    shell(*call, "--rate 50")
    run = read_csv(tmp_path / "runs" / "x.csv")
    assert np.diff(run.time_s) == pytest.approx(0.02) and run.columns["q1_rad"] == pytest.approx(np.arange(100) / 100)
