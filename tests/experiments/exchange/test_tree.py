"""Structs, groups, matrices and records by name; pickles, cells and expressions are refused; wrong rows are named."""

import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.io import savemat

from daq import Column, InputError, parse_rig
from daq.runs import read_csv
from experiments.exchange import ImportedFile, apply_map, load_any_run, read_imported
from experiments.exchange.imported import Table
from tests.support.imported_files import table
from tests.support.paths import DEMO_RIG, ROOT
from tests.support.shell import Shell
from tests.support.tree_files import Maker, npz, records, structs

T = np.arange(200) / 100.0
COLUMNS = {"t": T, "a": np.sin(3.0 * T), "b": np.sin(3.0 * T) + 0.5 * np.cos(2.0 * T)}
RELATIVE = COLUMNS["b"] - COLUMNS["a"]


@pytest.mark.parametrize("file, make, names", [
    ("x.mat", structs, ("log.time", "log.state.q[1]", "log.state.q[2]")), ("x.npz", npz, ("t", "a", "b")),
    ("x.json", records, ("entries.t", "entries.a", "entries.b"))])
def test_each_kind_by_its_names_with_relative_angles(file: str, make: Maker, names: tuple[str, str, str],
                                                     tmp_path: Path) -> None:
    make(COLUMNS, tmp_path / file)
    t, a, b = names
    run = apply_map(read_imported(tmp_path / file), {
        "time_s": Column(name=t), "q1_rad": Column(name=a), "q2_rad": Column(name=b, minus=a)}, 100.0)
    assert_allclose(run["q2_rad"], np.interp(run.time_s, T, RELATIVE), atol=1e-6)
    assert len(run) >= len(T) - 1


def test_groups_of_hdf5(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["log/t"], file["log/q"] = T, np.column_stack([COLUMNS["a"], COLUMNS["b"]])
    assert read_imported(tmp_path / "x.h5").names == ["log/q[1]", "log/q[2]", "log/t"]


@pytest.mark.parametrize("name, program", [("x.pkl", "pickle"), ("x.PICKLE", "pickle"), ("x.pt", "PyTorch"),
                                               ("x.pth", "PyTorch")])
@pytest.mark.parametrize("command", ["import", "fit"])
def test_a_pickle_is_refused_with_what_to_save(command: str, name: str, program: str, tmp_path: Path,
                                               shell: Shell) -> None:
    (tmp_path / name).write_bytes(pickle.dumps(COLUMNS))
    said = shell.fails(command, tmp_path / name, *("--out", tmp_path) if command == "import" else ("--rig", DEMO_RIG))
    assert f"{name}: is a {program} file" in said and "save its columns as CSV, Parquet or .npz" in said


def test_what_the_page_saves_from_a_pickle_is_read(here: Path) -> None:
    """The lines of docs/exchange.md."""
    Path("log.pkl").write_bytes(pickle.dumps(COLUMNS))
    page = (ROOT / "docs/exchange.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(code, {})
    for name in ("log.npz", "log.csv"):
        assert set(read_imported(name).names) == {"t", "a", "b"}


def test_cells_and_trials_are_named_with_what_to_do(here: Path, shell: Shell) -> None:
    trials = np.empty((1, 2), dtype=object)
    trials[0] = [COLUMNS["a"], COLUMNS["a"][:150]]
    savemat(here / "x.mat", {"t": T, "knee": trials, "stack": np.zeros((3, 200, 2)), "names": ["hip", "knee"]})
    found = read_imported(here / "x.mat")
    assert found.names == ["t"] and set(found.left_out) == {"knee", "stack"}
    for name in ("knee", "knee{1}"):
        with pytest.raises(InputError, match=r"column 'knee' is no table of numbers; save each of its parts under a"):
            apply_map(found, {"time_s": Column(name="t"), "q1_rad": Column(name=name)})
    said = shell.fails("import x.mat --out", here)
    assert "'knee' is no table of numbers: save each of its parts" in said


def test_cells_of_matlab_7_3_are_named_too(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["t"], file["#refs#/a"] = T, COLUMNS["a"]
        file["knee"] = np.array([file["#refs#/a"].ref, file["#refs#/a"].ref], dtype=h5py.ref_dtype)
    found = read_imported(tmp_path / "x.h5")
    assert found.names == ["t"] and set(found.left_out) == {"knee"}


@pytest.mark.parametrize("name", ["b - a", "a * 2", "a / b", "kne - a", "2*(a)"])
@pytest.mark.parametrize("column", ["q1_rad", "q1_cmd_rad", "time_s"])
def test_a_map_computes_nothing(column: str, name: str, tmp_path: Path) -> None:
    npz(COLUMNS, tmp_path / "x.npz")
    columns = {"time_s": Column(name="t"), "q1_rad": Column(name="a"), column: Column(name=name)}
    with pytest.raises(InputError, match=r"a map computes nothing; compute it before the import, or take one column"):
        apply_map(read_imported(tmp_path / "x.npz"), columns)


def test_a_rig_s_map_computes_nothing_either(tmp_path: Path) -> None:
    table(tmp_path / "x.csv", dict.fromkeys(("time_s", "thigh", "shank"), T))
    rig = parse_rig('[mechanism]\nmodel = "joint1"\nactuated = []\n[columns.q1_rad]\nname = "shank - thigh"\n')
    with pytest.raises(InputError, match="a map computes nothing"):
        load_any_run(tmp_path / "x.csv", rig)


def test_a_column_is_taken_off_another(tmp_path: Path) -> None:
    npz({"t": T, "/j/a - x": COLUMNS["a"], "b": COLUMNS["b"], "short": T[:9]}, tmp_path / "x.npz")
    found = read_imported(tmp_path / "x.npz")
    columns = {"time_s": Column(name="t"), "q1_rad": Column(name="/j/a - x"),
               "q2_rad": Column(name="b", minus="/j/a - x", sign=-1, scale=2.0, offset=0.5)}
    assert_allclose(apply_map(found, columns, 100.0)["q2_rad"], 0.5 - 2.0 * RELATIVE)
    with pytest.raises(InputError, match="'short' has 9 rows, that which it is taken off 200"):
        apply_map(found, {**columns, "q2_rad": Column(name="b", minus="short")})
    with pytest.raises(InputError, match="has no column 'c'"):
        apply_map(found, {**columns, "q2_rad": Column(name="b", minus="c")})


def test_columns_with_times_of_their_own_are_taken_off_by_lines_between_samples() -> None:
    slow = T[::4]
    found = ImportedFile("x", (Table({"b": COLUMNS["b"]}, T), Table({"a": 3.0 * slow}, slow)))
    run = apply_map(found, {"q1_rad": Column(name="b", minus="a")}, 100.0)
    within = run.time_s <= slow[-1]
    assert_allclose(run["q1_rad"][within], (COLUMNS["b"] - 3.0 * T)[: within.sum()], atol=1e-9)


def test_wrong_rows_are_left_out_by_number(here: Path, shell: Shell) -> None:
    lines = ["t,a,other", *(f"{t:.3f},{a:.9g},1" for t, a in zip(T, COLUMNS["a"]))]
    for k, cell in ((60, "ERR"), (80, "1e30")):
        t, _, other = lines[k].split(",")
        lines[k] = f"{t},{cell},{other}"
    lines[70] += ",7"
    lines[90] = lines[89]
    (here / "x.csv").write_text("\n".join(lines))
    (here / "m.toml").write_text('[columns.time_s]\nname = "t"\n[columns.q1_rad]\nname = "a"\n')
    shell("import x.csv --map m.toml --out out")
    said = shell.err
    for part in ("4 wrong samples", "line 71 (has 4 cells", "line 61 ('a' holds 'ERR')", "larger than any reading",
                 "its time is not after the one before"):
        assert part in said, said
    run = read_csv(here / "out/x.csv")
    assert_allclose(run.columns["q1_rad"], np.sin(3.0 * run.time_s), atol=1e-4)


def test_a_bad_file_does_not_stop_the_others_and_all_can_be_repeated(here: Path,
                                                                     shell: Shell) -> None:
    for name in ("a.npz", "c.npz", "d/a.npz"):
        (here / name).parent.mkdir(exist_ok=True)
        npz(COLUMNS, here / name)
    (here / "b.npz").write_text("no")
    (here / "m.toml").write_text('[columns.time_s]\nname = "t"\n[columns.q1_rad]\nname = "a"\n')
    out = here / "out"
    files = [here / name for name in ("a.npz", "b.npz", "c.npz", "d/a.npz")]
    to = "--map m.toml --out", out
    made = {f"{here.name}-a.csv", "c.csv", "d-a.csv"}
    for _ in range(2):
        shell("import", *files, *to, status=2)
        said = shell.err
        assert "b.npz" in said and "1 of 4 files not imported" in said and "exists already" not in said
        assert {path.name for path in out.iterdir()} == made
    (here / "m.toml").write_text('[columns.time_s]\nname = "t"\n[columns.q1_rad]\nname = "b"\n')
    del files[1]
    shell("import", *files, *to, status=2)
    assert "exists already" in shell.err
    shell("import", *files, *to, "--force")
    assert_allclose(read_csv(out / "c.csv").columns["q1_rad"], COLUMNS["b"], atol=1e-9)


def test_a_grid_finer_than_the_record_is_said(tmp_path: Path) -> None:
    t = np.arange(200) / 50.0
    table(tmp_path / "x.csv", {"time_s": t, "q1_rad": np.sin(t), "tau1_nm": np.cos(t)}, 9)
    said = {}
    for grid in (50, 100):
        rig = parse_rig(f'[mechanism]\nmodel = "joint1"\nactuated = [1]\n[sampling]\nrate_hz = {grid}\n')
        said[grid] = [str(one) for one in load_any_run(tmp_path / "x.csv", rig).flags]
    assert said[50] == [] and "nothing is interpolated" in said[100][0] and "take rate_hz out" in said[100][0]


def test_the_measured_angle_goes_before_the_desired_one(tmp_path: Path) -> None:
    from experiments.exchange.guess_names import fitting

    npz({"shoulder_des_pos": COLUMNS["a"], "shoulder_meas_pos": COLUMNS["b"]}, tmp_path / "x.npz")
    assert fitting(read_imported(tmp_path / "x.npz"), "q1", True) == ["shoulder_meas_pos"]
