"""`legid import FILES` without a flag: what it shows, asks, writes, and does when repeated."""

import sys
from pathlib import Path

import numpy as np
import pytest

from daq.runs import read_csv
from tests.support.driven_joint import record
from tests.support.shell import Shell, typed


@pytest.fixture
def files(tmp_path: Path) -> list[str]:
    """Two logs of a joint that swings, and one without its angle."""
    made = [record(tmp_path / f"log{k}.csv", unit=np.pi / 180) for k in range(2)]
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
        f"then: legid import {' '.join(files)} --map {out / 'columns.toml'} --out {out}")
    assert sorted(p.name for p in out.iterdir()) == ["columns.html", "columns.toml"]


def test_the_command_that_it_names_works_next_to_the_logs(files: list[str], tmp_path: Path,
                                                         monkeypatch: pytest.MonkeyPatch,
                                                         shell: Shell) -> None:
    """A log that is a CSV would be written onto itself."""
    monkeypatch.chdir(tmp_path)
    shell("import log0.csv --map columns.toml --guess")
    shell(shell.out.splitlines()[-1].removeprefix("then: legid "))
    assert read_csv(tmp_path / "runs" / "log0.csv").columns["q1_rad"].size == 3000


@pytest.mark.parametrize("answer, imported", [("y", True), ("n", False), ("", False)])
def test_it_asks_a_person(answer: str, imported: bool, files: list[str], here: Path,
                          monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda question: answer)
    typed("import", *files[:2], "--out runs")
    assert sorted(p.name for p in (here / "runs").glob("*.csv")) == (["log0.csv", "log1.csv"] if imported else [])


def test_yes_imports_and_can_be_repeated(files: list[str], here: Path) -> None:
    for _ in range(2):
        typed("import", *files[:2], "--out runs --yes")
    run = read_csv(here / "runs" / "log1.csv").columns
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
