"""Files of other programs: guessed, imported and fitted; and what a map or a file may not say."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rosbags.rosbag2 import StoragePlugin
from scipy.io import savemat

import legid
from daq import Column, Dataset, InputError, parse_rig
from daq.runs import write_csv
from experiments.exchange import apply_map, load_any_run, load_map, map_text, read_imported
from experiments.exchange.delimited import read_delimited
from legid.cli import main
from tests.support.imported_files import guess, matlab, plotjuggler, ros2_bag, spreadsheet
from tests.support.mujoco_leg import Leg, record
from tests.support.shell import Shell, document, typed, values

LEG = Leg(coulomb=(0.01, 0.02))
RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = 0.2\n'
Made = Callable[[Dataset, Path], Path]


@pytest.fixture(scope="module")
def run() -> Dataset:
    return record(LEG, 7, seconds=15.0, amplitude=1.0, name="x")


@pytest.mark.parametrize("file, make", [
    ("x.csv", spreadsheet), ("x.csv", plotjuggler), ("x.mat", matlab),
    ("bag", partial(ros2_bag, plugin=StoragePlugin.MCAP)), ("bag", partial(ros2_bag, plugin=StoragePlugin.SQLITE3))],
    ids=["spreadsheet", "plotjuggler", "matlab", "ros2-mcap", "ros2-sqlite"])
def test_from_somebody_s_file_to_a_fit_in_three_commands(file: str, make: Made, run: Dataset,
                                                         here: Path) -> None:
    """Guess, import, fit: the parameters are those of the run before it was written in another's way."""
    (here / "rig.toml").write_text(RIG)
    theirs = make(run, here / file)
    columns, out = here / "columns.toml", here / "runs"
    typed("import", theirs, "--guess --map columns.toml")
    assert "<svg" in columns.with_suffix(".html").read_text()
    if make is plotjuggler:  # no file says how late its stamps are; who knows adds it
        columns.write_text(re.sub(r'(name = "/imu/.*")', r"\1\ndelay = 0.002", columns.read_text()))
    typed("import", theirs, "--map columns.toml --out runs")
    (imported,) = out.iterdir()
    beta = values(document("fit", imported, "--rig rig.toml"))
    expected = legid.fit([run], parse_rig(RIG)).beta
    assert_allclose(beta[:5], expected[:5], rtol=1e-3)
    assert_allclose(beta[:5], LEG.beta()[:5], rtol=0.03)


def test_the_map_in_the_rig_file_does_the_same(run: Dataset, tmp_path: Path) -> None:
    theirs = matlab(run, tmp_path / "x.mat")
    mapped = apply_map(read_imported(theirs), guess(theirs), 100.0)
    rig = parse_rig(RIG + (tmp_path / "x.toml").read_text())
    read = load_any_run(theirs, rig)
    for name in ("q2_rad", "tau2_nm", "gyro_radps"):
        assert_array_equal(read[name], mapped[name])
    assert np.abs(np.abs(read["q2_rad"]) - np.abs(run["q2_rad"])).max() < 1e-12
    write_csv(replace(run, clock_bound_s=1e-4), tmp_path / "own.csv")  # which the map does not speak of
    own = load_any_run(tmp_path / "own.csv", rig)
    assert own.clock_bound_s == 1e-4 and set(own.columns) == set(run.columns)


def as_csv(columns: dict[str, np.ndarray], path: Path) -> Path:
    path.parent.mkdir(exist_ok=True)
    rows = (",".join("" if np.isnan(v) else f"{v:.9g}" for v in row) for row in zip(*columns.values()))
    path.write_text("\n".join([",".join(columns), *rows, ""]))
    return path


def logged(run: Dataset, **others: np.ndarray) -> dict[str, np.ndarray]:
    """Columns as somebody's logger may call them; `others` replace or join them."""
    own = {"t": run.time_s, "knee": run["q2_rad"], "torque": run["tau2_nm"], "gz": run["gyro_radps"],
           "ax": run["accel_x_mps2"], "ay": run["accel_y_mps2"]}
    return own | others


def guessed(columns: dict[str, np.ndarray], tmp_path: Path, shell: Shell
            ) -> tuple[int, dict[str, Column], str]:
    """Exit status, the map, and what was printed."""
    status = main(["import", str(as_csv(columns, tmp_path / "x.csv")), "--guess", "--map", str(tmp_path / "m.toml")])
    said = shell.read()
    return status, load_map(tmp_path / "m.toml"), said.out + said.err


def test_what_no_unit_explains_is_not_guessed(run: Dataset, tmp_path: Path, shell: Shell) -> None:
    """A motor's angle, interchanged joints, an accelerometer without gravity, an absolute angle."""
    q1, q2 = run["q1_rad"], run["q2_rad"]
    free = {"ax": run["accel_x_mps2"] - 9.81 * np.sin(q1), "ay": run["accel_y_mps2"] + 9.81 * np.cos(q1)}
    swapped = {"t": run.time_s, "knee": q1, "hip": q2, "torque": run["tau2_nm"]}
    files = [logged(run, knee=50.0 * q2 / (2.0 * np.pi)), swapped, logged(run, **free)]
    for k, columns in enumerate(files):
        status, _, said = guessed(columns, tmp_path / str(k), shell)
        assert status == 1 and "NOT KNOWN" in said and "positive definite" not in said, said
        page = (tmp_path / str(k) / "m.html").read_text()
        assert 'data-tone="bad"' in page and page.index("NOT TO BE USED") < page.index("<table")
    status, _, said = guessed(logged(run, knee=q1 + q2), tmp_path / "absolute", shell)
    assert status == 1 and "'knee' looks absolute, counted from the vertical" in said, said


def test_units_by_physics_where_names_are_silent_or_wrong(run: Dataset, tmp_path: Path,
                                                          shell: Shell) -> None:
    said = {}
    for k, (columns, units) in enumerate([
            (logged(run, knee=1e3 * run["q2_rad"], gz=np.rad2deg(1e3 * run["gyro_radps"])), ("mrad", "mdps")),
            ({"t": run.time_s, "hip_deg": np.rad2deg(run["q1_rad"]), "knee": np.rad2deg(run["q2_rad"]),
              "iq_A": run["tau2_nm"]}, ("deg", "deg")),
            (logged(run) | {"knee_rad": np.rad2deg(run["q2_rad"]), "knee": np.ones(len(run))}, ("deg", ""))]):
        status, found, said[k] = guessed(columns, tmp_path / str(k), shell)
        other = found["gyro_radps"] if "gyro_radps" in found else found["q1_rad"]
        assert status == 0 and (found["q2_rad"].unit, other.unit) == units, said[k]
    assert "N m per A of 'iq_A'" in said[1] and "says rad, but in deg" in said[2]


def test_a_pivot_s_zero_does_not_keep_a_leg_from_being_read(run: Dataset, tmp_path: Path, shell: Shell) -> None:
    """An IMU that is turned by a few degrees, and an encoder whose zero is not where the leg hangs."""
    x, y = run["accel_x_mps2"], run["accel_y_mps2"]
    turned = {"ax": np.cos(0.06) * x - np.sin(0.06) * y, "ay": np.sin(0.06) * x + np.cos(0.06) * y}
    hip = {"t": run.time_s, "hip": run["q1_rad"] + 0.4, "knee": -run["q2_rad"], "torque": run["tau2_nm"]}
    for k, (columns, sign) in enumerate([(logged(run, **turned), 1), (hip, -1)]):
        status, found, said = guessed(columns, tmp_path / str(k), shell)
        assert status == 0 and (found["q2_rad"].unit, found["q2_rad"].sign) == ("", sign), said
    assert re.search(r"joint 1 hangs at 0\.[34]\d rad", said), said


def test_gaps_and_a_second_angle_do_not_mislead(run: Dataset, tmp_path: Path,
                                                shell: Shell) -> None:
    knee = run["q2_rad"].copy()
    knee[::17] = knee[100:130] = np.nan
    columns = logged(run) | {"motor_pos": 50.0 * run["q2_rad"], "load_pos": knee}
    del columns["knee"]
    columns["t"] = np.where(np.arange(len(run)) == 40, np.nan, run.time_s)
    status, found, said = guessed(columns, tmp_path, shell)
    assert status == 0 and found["q2_rad"] == Column(name="load_pos"), said


@pytest.mark.parametrize("change, words", [
    ({"knee": None}, "'knee' holds 'ERR' in line 61"), ({"torque": np.zeros(1)}, "'torque' never changes"),
    ({"gz": np.full(1, np.nan)}, "'gz' is blank"), ({"t": np.array([0.0, -1.0])}, "'t' runs backwards"),
    ({"t": np.zeros(1)}, "'t' stands still")])
def test_a_column_that_cannot_be_used_is_named(change: dict[str, np.ndarray | None], words: str, run: Dataset,
                                               here: Path, shell: Shell) -> None:
    ((name, values),) = change.items()
    columns = logged(run, **{name: np.resize(run["q2_rad"] if values is None else values, len(run))})
    text = as_csv(columns, here / "x.csv").read_text().splitlines()
    if values is None:
        text[60::10] = [re.sub(r"^([^,]*),[^,]*", r"\1,ERR", line) for line in text[60::10]]
    (here / "x.csv").write_text("\n".join(text))
    assert words in shell.fails("import x.csv --guess --map m.toml")


def test_a_count_of_rows_is_no_time(run: Dataset, here: Path, shell: Shell) -> None:
    columns = {"sample": np.arange(float(len(run))), **logged(run)}
    del columns["t"]
    assert "lacks a time" in shell.fails("import", as_csv(columns, here / "x.csv"), "--guess --map m")


def test_scale_sign_offset_and_delay(tmp_path: Path) -> None:
    t = np.arange(300) / 100.0
    lines = ["t,i,w", *(f"{a:.3f},{2 * a:.9g},{np.sin(a - 0.02):.9g}" for a in t)]
    (tmp_path / "x.csv").write_text("\n".join(lines))
    run = apply_map(read_delimited(tmp_path / "x.csv"), {
        "time_s": Column(name="t"), "tau2_nm": Column(name="i", unit="mA", scale=3.0, sign=-1, offset=0.5),
        "q2_rad": Column(name="w", delay=0.02)})
    assert_allclose(run["tau2_nm"], 0.5 - 6e-3 * run.time_s, atol=1e-9)
    assert_allclose(run["q2_rad"], np.sin(run.time_s), atol=1e-6)


@pytest.mark.parametrize("text", [
    "a\tb\n1.5\t2\n3\t4\n", "a;b\n1,5;2\n3;4\n", "# made by hand\n# a b\n1.5 2\n3 4\n", "a|b\n1.5|2\n3|4",
    "a,b,remark\r\n1.5,2,ok\r\n3,4,\r\n", 'title\n"a","b"\n"1.5","2"\n"3","4"\n'])
def test_dialects(text: str, tmp_path: Path) -> None:
    (tmp_path / "x.txt").write_bytes(text.encode())
    (table,) = read_delimited(tmp_path / "x.txt").tables
    assert {name: list(values) for name, values in table.columns.items() if name != "remark"} == {
        "a": [1.5, 3.0], "b": [2.0, 4.0]}


def test_a_map_reads_back_as_it_was_written(tmp_path: Path) -> None:
    columns = {"time_s": Column(name='t "raw" [ms]', unit="ms"), "q2_rad": Column(name="k", sign=-1, delay=0.5)}
    (tmp_path / "m.toml").write_text(map_text(columns, {"q2_rad": "one\ntwo"}))
    assert load_map(tmp_path / "m.toml") == columns


@pytest.mark.parametrize("text, words", [
    ("", "has no [columns]"), ("[columns.knee]\nname = 'a'", "is no column of a run"),
    ("[columns.q2_rad]\nname = 'a'\nunit = 'degs'", "did you mean 'deg'"),
    ("[columns.q2_rad]\nunit = 'deg'", "name"), ("[columns.q2_rad]\nname = 'a'\nsign = 2", "sign"),
    ("[columns.q2_rad]\nname = 'a'\nscale = 0.0", "a scale is not 0"), ("[columns", "not valid TOML")])
def test_maps_that_cannot_be(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(text)
    with pytest.raises(InputError, match=re.escape(words)):
        load_map(tmp_path / "m.toml")


def test_files_that_cannot_be(here: Path, shell: Shell) -> None:
    (here / "m.toml").write_text("[columns.time_s]\nname = 't'\n[columns.q2_rad]\nname = 'kne'\n")
    rows = "".join(f"{k},{k}\n" for k in range(60))
    for name, text, said in (
            ("a.csv", "t,knee\n" + rows, "did you mean 'knee'"), ("b.csv", "", "no table of numbers"),
            ("c.mat", "no", "cannot be read as a MATLAB file"), ("d.parquet", "no", "cannot be read as Parquet"),
            ("e.db3", "no", "cannot be read as a ROS bag"), ("f.doc", "x", "of no kind that is known"),
            ("g.csv", "t,kne\n" + rows + "3,3\n4,4\n", "runs backwards in 2 of 62 rows, first in row 61")):
        (here / name).write_text(text)
        assert said in shell.fails("import", here / name, "--map m.toml --out out")


def test_of_a_matlab_variable_that_occurs_twice_the_second_is_used_and_told(
        here: Path, shell: Shell, recwarn: pytest.WarningsRecorder) -> None:
    time = np.arange(60) / 100.0
    for name, content in (("one", {"t": time, "knee": np.zeros(60)}), ("two", {"knee": np.sin(time)})):
        savemat(here / name, content, appendmat=False)
    header = 128
    (here / "x.mat").write_bytes((here / "one").read_bytes() + (here / "two").read_bytes()[header:])
    (here / "m.toml").write_text("[columns.time_s]\nname = 't'\n[columns.q2_rad]\nname = 'knee'\n")
    shell("import x.mat --map m.toml --out o")
    assert "'knee' has the name of the second" in "".join(shell.read()) and not recwarn.list
    knee = np.genfromtxt(here / "o/x.csv", delimiter=",", names=True)["q2_rad"]
    assert knee[-1] == pytest.approx(np.sin(time[-1]), abs=1e-6)


def test_nothing_is_written_over(run: Dataset, here: Path, shell: Shell) -> None:
    theirs = spreadsheet(run, here / "x.csv")
    map_file = here / "x.toml"
    for _ in range(2):  # a guess that nobody has touched is made anew
        guess(theirs)
    map_file.write_text(map_file.read_text() + "# mine\n")
    guess(theirs, status=2)
    shell("import", theirs, "--map x.toml --out", here, status=2)
    assert shell.err.count("exists already") == 2
    assert theirs.read_bytes().startswith(b"\xff\xfe")
