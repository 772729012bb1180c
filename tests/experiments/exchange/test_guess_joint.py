"""The guess for a single driven joint: unit of its angle, sign of its torque, and what does not show."""

import json
from pathlib import Path

import numpy as np
import pytest

from daq.runs import read_csv
from experiments.cli import main
from experiments.exchange.column_map import load_map
from experiments.models import load_model
from tests.support.driven_joint import record

RIG = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n'


@pytest.mark.parametrize("names", [("pos", "effort"), ("joint_angle", "torque"), ("hip", "tau")])
@pytest.mark.parametrize(("unit", "written"), [(1.0, ""), (np.pi / 180, "deg"), (2 * np.pi, "turn")])
@pytest.mark.parametrize("sign", [1, -1])
def test_gravity_shows_the_unit_and_inertia_the_sign(names: tuple[str, str], unit: float, written: str, sign: int,
                                                     tmp_path: Path) -> None:
    file, columns = record(tmp_path / "x.csv", names, unit, sign, 1.0), tmp_path / "c.toml"
    assert main(["import", str(file), "--guess", "--map", str(columns)]) == 0
    found = load_map(columns)
    assert (found["q1_rad"].name, found["q1_rad"].unit) == (names[0], written)
    assert (found["tau1_nm"].name, found["tau1_nm"].sign) == (names[1], sign)


def test_a_joint_s_file_goes_to_a_fit(tmp_path: Path) -> None:
    file, columns = record(tmp_path / "x.csv", ("pos", "effort"), np.pi / 180, -1, 1.0), tmp_path / "c.toml"
    (tmp_path / "rig.toml").write_text(RIG)
    assert main(["import", str(file), "--guess", "--map", str(columns)]) == 0
    assert main(["import", str(file), "--map", str(columns), "--out", str(tmp_path / "runs")]) == 0
    assert main(["fit", str(tmp_path / "runs" / "x.csv"), "--rig", str(tmp_path / "rig.toml")]) == 0


def test_without_gravity_the_unit_is_said_not_to_show(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, columns = record(tmp_path / "x.csv", ("pos", "effort"), 1.0, 1, 0.0), tmp_path / "c.toml"
    assert main(["import", str(file), "--guess", "--map", str(columns)]) == 0
    assert "the unit of 'pos' does not show" in capsys.readouterr().err
    assert load_map(columns)["q1_rad"].unit == ""


def test_a_torque_of_another_machine_is_not_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = record(tmp_path / "x.csv", ("pos", "effort"), 1.0, 1, 1.0)
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    table[:, 2] = np.random.default_rng(2).normal(size=len(table)).cumsum()
    np.savetxt(file, table, delimiter=",", comments="", header="time,pos,effort")
    assert main(["import", str(file), "--guess", "--map", str(tmp_path / "c.toml")]) == 1
    assert "explains the torque 'effort'" in capsys.readouterr().err


@pytest.mark.parametrize(("unit", "written"), [(1.0, ""), (np.pi / 180, "deg")])
def test_a_pendulum_that_swings_freely_goes_to_a_fit(unit: float, written: str, tmp_path: Path,
                                                        capsys: pytest.CaptureFixture[str]) -> None:
    """No torque in the file: gravity still shows the unit, and one known number gives the scale."""
    h, q, v = 0.001, 2.5, 0.0
    angles = []
    for _ in range(20_000):
        v -= h * (9.81 * 0.02 * np.sin(q) + 4e-4 * v) / 0.005
        q += h * v
        angles.append(q)
    noise = np.random.default_rng(1).normal(0.0, 5e-4, 2000)
    np.savetxt(tmp_path / "swing.csv", np.stack([np.arange(2000) * 0.01, (angles[::10] + noise) / unit], axis=1),
               delimiter=",", comments="", header="t,theta")
    (tmp_path / "rig.toml").write_text('[mechanism]\nmodel = "joint1"\nactuated = []\n')
    assert main(["import", str(tmp_path / "swing.csv"), "--out", str(tmp_path / "runs"), "--yes"]) == 0
    found = load_map(tmp_path / "runs" / "columns.toml")
    assert set(found) == {"time_s", "q1_rad"} and found["q1_rad"].unit == written
    assert "a joint that swings freely" in capsys.readouterr().out
    model, run, rig = (str(tmp_path / name) for name in ("model.json", "runs/swing.csv", "rig.toml"))
    assert main(["fit", run, "--rig", rig, "--fix", "beta2=0.02", "--model-out", model]) == 0
    assert load_model(model).parameters[0].value == pytest.approx(0.005, rel=0.01)


def test_a_table_without_a_header_is_said_to_have_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = record(tmp_path / "x.csv", ("pos", "effort"), 1.0, 1, 1.0)
    file.write_text("\n".join(file.read_text().splitlines()[1:]))
    assert main(["import", str(file), "--guess", "--map", str(tmp_path / "c.toml")]) == 2
    assert "has no header line: its 3 columns have no names" in capsys.readouterr().err


def test_seconds_of_a_record_are_imported_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A hand holds the pendulum before it is let go."""
    file = record(tmp_path / "x.csv", ("pos", "effort"), 1.0, 1, 1.0)
    out, columns = tmp_path / "runs", tmp_path / "runs" / "columns.toml"
    assert main(["import", str(file), "--out", str(out), "--yes", "--span", "5,9"]) == 0
    time_s = read_csv(out / "x.csv").time_s
    assert (time_s[0], time_s[-1]) == (pytest.approx(5.0), pytest.approx(8.995))
    capsys.readouterr()
    for wanted, said in (("50,66", "no sample between 50 and 66 s; it goes from 0 to 14.995 s"),
                         ("9,5", "'9,5' is not FROM,TO in seconds"), ("5", "is not FROM,TO")):
        assert main(["import", str(file), "--map", str(columns), "--out", str(out), "--span", wanted]) == 2
        assert said in capsys.readouterr().err


def test_a_span_of_a_record_by_the_calendar_is_said_to_the_millisecond(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, columns = tmp_path / "x.csv", tmp_path / "c.toml"
    file.write_text("t,a\n" + "".join(f"{1.7e9 + k / 100:.2f},{k / 100:.2f}\n" for k in range(100)))
    columns.write_text('[columns.time_s]\nname = "t"\n[columns.q1_rad]\nname = "a"\n')
    call = ["import", str(file), "--map", str(columns), "--out", str(tmp_path / "runs"), "--span"]
    assert main([*call, "0,1"]) == 2
    assert "it goes from 1700000000 to 1700000000.99 s" in capsys.readouterr().err
    assert main([*call, "1700000000.1,1700000000.8"]) == 0


def test_a_file_without_times_needs_a_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, columns = tmp_path / "x.json", tmp_path / "c.toml"
    file.write_text(json.dumps({"rate": 50, "data": {"angles": [k / 100 for k in range(100)]}}))
    columns.write_text('[columns.q1_rad]\nname = "data.angles"\n')
    call = ["import", str(file), "--map", str(columns), "--out", str(tmp_path / "runs")]
    assert main(call) == 2
    assert "has no times" in (said := capsys.readouterr().err) and "--rate" in said
    assert main([*call, "--rate", "50"]) == 0
    run = read_csv(tmp_path / "runs" / "x.csv")
    assert np.diff(run.time_s) == pytest.approx(0.02) and run.columns["q1_rad"] == pytest.approx(np.arange(100) / 100)
