"""Cells, structs, groups, archives: read by name; a pickle runs nothing; a map computes; what is wrong is named."""

import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from daq.errors import InputError
from daq.rig import load_rig
from daq.rig_columns import Column
from daq.runs.csv_run import read_csv
from experiments.cli import main
from experiments.exchange.column_map import apply_map
from experiments.exchange.reading import load_any_run, read_imported
from tests.support.nested_files import Maker, cells, npz, pickled, records, structs, torch_archive

T = np.arange(200) / 100.0
COLUMNS = {"t": T, "a": np.sin(3.0 * T), "b": np.sin(3.0 * T) + 0.5 * np.cos(2.0 * T)}
RELATIVE = COLUMNS["b"] - COLUMNS["a"]


@pytest.mark.parametrize(("file", "make", "names"), [
    ("x.mat", structs, ("log.time", "log.state.q[1]", "log.state.q[2]")), ("x.npz", npz, ("t", "a", "b")),
    ("x.json", records, ("entries.t", "entries.a", "entries.b")), ("x.pkl", pickled, ("log.t", "log.a", "rows.b")),
    ("x.pt", torch_archive, ("t", "a", "b"))])
def test_each_kind_by_its_names_with_relative_angles(file: str, make: Maker, names: tuple[str, str, str],
                                                     tmp_path: Path) -> None:
    make(COLUMNS, tmp_path / file)
    t, a, b = names
    run = apply_map(read_imported(tmp_path / file), {
        "time_s": Column(name=t), "q1_rad": Column(name=a), "q2_rad": Column(name=f"{b} - {a}")}, 100.0)
    np.testing.assert_allclose(run["q2_rad"], np.interp(run.time_s, T, RELATIVE), atol=1e-6)
    assert len(run) >= len(T) - 1


def test_groups_of_hdf5(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["log/t"], file["log/q"] = T, np.column_stack([COLUMNS["a"], COLUMNS["b"]])
    assert read_imported(tmp_path / "x.h5").names == ["log/q[1]", "log/q[2]", "log/t"]


class Harmful:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return os.mkdir, (str(self.path),)


def test_a_pickle_runs_nothing(tmp_path: Path) -> None:
    data = pickle.dumps({"x": Harmful(tmp_path / "harm"), **COLUMNS})
    (tmp_path / "x.pkl").write_bytes(data)
    assert set(read_imported(tmp_path / "x.pkl").names) == set(COLUMNS)
    assert not (tmp_path / "harm").exists()
    pickle.loads(data)
    assert (tmp_path / "harm").exists()  # what any other reader would have done


def test_a_storage_that_is_too_short_is_refused(tmp_path: Path) -> None:
    import zipfile

    torch_archive(COLUMNS, tmp_path / "x.pt")
    with zipfile.ZipFile(tmp_path / "x.pt") as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(tmp_path / "y.pt", "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data[:16] if name.endswith("data/1") else data)
    with pytest.raises(InputError, match=r"cannot be read as \.pt"):
        read_imported(tmp_path / "y.pt")


def test_cells_are_a_run_each(tmp_path: Path) -> None:
    short = {name: values[:150] for name, values in COLUMNS.items()}
    savemat(tmp_path / "x.mat", {name: cells(COLUMNS[name], short[name]) for name in COLUMNS})
    (tmp_path / "m.toml").write_text('[columns.time_s]\nname = "t{*}"\n[columns.q1_rad]\nname = "a{*}"\n'
                                     '[columns.q2_rad]\nname = "b{*} - 0.5 * a{*}"\n')
    assert main(["import", str(tmp_path / "x.mat"), "--map", str(tmp_path / "m.toml"),
                 "--out", str(tmp_path / "out")]) == 0
    first, second = (read_csv(tmp_path / "out" / f"x-{k}.csv") for k in (1, 2))
    assert (first.time_s.size, second.time_s.size) == (200, 150)
    np.testing.assert_allclose(first.columns["q2_rad"], COLUMNS["b"] - 0.5 * COLUMNS["a"], atol=1e-9)


@pytest.mark.parametrize(("name", "words"), [
    ("kne - a", "no column and no expression"), ("a ** b", "no column and no expression"),
    ("a - ", "no column and no expression"), ("__import__(a)", "no column and no expression"),
    ("kne", "has no column 'kne'")])
def test_expressions_that_cannot_be(name: str, words: str, tmp_path: Path) -> None:
    npz(COLUMNS, tmp_path / "x.npz")
    with pytest.raises(InputError) as caught:
        apply_map(read_imported(tmp_path / "x.npz"), {"time_s": Column(name="t"), "q1_rad": Column(name=name)})
    assert words in str(caught.value)


def test_names_with_signs_in_them(tmp_path: Path) -> None:
    npz({"t": T, "/j/a-x": COLUMNS["a"], "/j/a": COLUMNS["b"], "a": T}, tmp_path / "x.npz")
    run = apply_map(read_imported(tmp_path / "x.npz"), {
        "time_s": Column(name="t"), "q1_rad": Column(name="/j/a-x"), "q2_rad": Column(name="/j/a-x - 2*(/j/a)"),
        "q3_rad": Column(name="'a' / 4")}, 100.0)
    np.testing.assert_allclose(run["q2_rad"], COLUMNS["a"] - 2.0 * COLUMNS["b"])
    np.testing.assert_allclose(run["q3_rad"], T / 4.0)


def test_wrong_rows_are_left_out_by_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = ["t,a,other", *(f"{t:.3f},{a:.9g},1" for t, a in zip(T, COLUMNS["a"]))]
    lines[60] = re_celled(lines[60], "ERR")
    lines[70] += ",7"
    lines[80] = re_celled(lines[80], "1e30")
    lines[90] = lines[89]
    (tmp_path / "x.csv").write_text("\n".join(lines))
    (tmp_path / "m.toml").write_text('[columns.time_s]\nname = "t"\n[columns.q1_rad]\nname = "a"\n')
    assert main(["import", str(tmp_path / "x.csv"), "--map", str(tmp_path / "m.toml"),
                 "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    for part in ("4 wrong samples", "line 71 (has 4 cells", "line 61 ('a' holds 'ERR')", "larger than any reading",
                 "its time is not after the one before"):
        assert part in said, said
    run = read_csv(tmp_path / "out/x.csv")
    np.testing.assert_allclose(run.columns["q1_rad"], np.sin(3.0 * run.time_s), atol=1e-4)


def re_celled(line: str, cell: str) -> str:
    t, _, other = line.split(",")
    return f"{t},{cell},{other}"


def test_a_bad_file_does_not_stop_the_others_and_all_can_be_repeated(tmp_path: Path,
                                                                     capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a.npz", "c.npz", "d/a.npz"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        npz(COLUMNS, tmp_path / name)
    (tmp_path / "b.npz").write_text("no")
    (tmp_path / "m.toml").write_text('[columns.time_s]\nname = "t"\n[columns.q1_rad]\nname = "a"\n')
    out = tmp_path / "out"
    files = [str(tmp_path / name) for name in ("a.npz", "b.npz", "c.npz", "d/a.npz")]
    command = ["import", *files, "--map", str(tmp_path / "m.toml"), "--out", str(out)]
    made = {f"{tmp_path.name}-a.csv", "c.csv", "d-a.csv"}
    for _ in range(2):
        assert main(command) == 2
        said = capsys.readouterr().err
        assert "b.npz" in said and "1 of 4 files not imported" in said and "exists already" not in said
        assert {path.name for path in out.iterdir()} == made
    (tmp_path / "m.toml").write_text('[columns.time_s]\nname = "t"\n[columns.q1_rad]\nname = "b"\n')
    del command[2]
    assert main(command) == 2 and "exists already" in capsys.readouterr().err
    assert main([*command, "--force"]) == 0
    np.testing.assert_allclose(read_csv(out / "c.csv").columns["q1_rad"], COLUMNS["b"], atol=1e-9)


def test_a_grid_finer_than_the_record_is_said(tmp_path: Path) -> None:
    t = np.arange(200) / 50.0
    (tmp_path / "x.csv").write_text("\n".join(["time_s,q1_rad,tau1_nm", *(
        f"{a:.3f},{np.sin(a):.9g},{np.cos(a):.9g}" for a in t)]))
    said = {}
    for grid in (50, 100):
        (tmp_path / "rig.toml").write_text('[mechanism]\nmodel = "joint1"\nactuated = [1]\n'
                                           f"[sampling]\nrate_hz = {grid}\n")
        said[grid] = [str(one) for one in load_any_run(tmp_path / "x.csv", load_rig(tmp_path / "rig.toml")).flags]
    assert said[50] == [] and "nothing is interpolated" in said[100][0] and "take rate_hz out" in said[100][0]


def test_the_measured_angle_goes_before_the_desired_one(tmp_path: Path) -> None:
    from experiments.exchange.guess_names import fitting

    npz({"shoulder_des_pos": COLUMNS["a"], "shoulder_meas_pos": COLUMNS["b"]}, tmp_path / "x.npz")
    assert fitting(read_imported(tmp_path / "x.npz"), "q1", True) == ["shoulder_meas_pos"]
