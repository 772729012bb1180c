"""Python has what the commands have: the guess of a map, exports, pages, a first line and a table, a short repr."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import legid
from tests.support.imported_files import degrees_log
from tests.support.paths import FIXTURES
from tests.support.shell import Shell, document, typed

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n'


@pytest.fixture(scope="module")
def log(module_path: Path) -> Path:
    (module_path / "rig.toml").write_text(RIG)
    return degrees_log(module_path / "log.csv", 11, "Zeit")


def sections(page: Path) -> list[str]:
    """Headings of a page, and its first table's rows."""
    text = page.read_text()
    return [*re.findall(r"<h[12][^>]*>(.*?)</h[12]>", text), *re.findall(r"<td[^>]*>(.*?)</td>", text)[:60]]


def test_a_guess_is_the_command_s_and_reads_the_file(log: Path, tmp_path: Path) -> None:
    typed("import", log, "--guess --map", tmp_path / "typed.toml")
    guess = legid.guess(log)
    guess.write(tmp_path / "map.toml")
    guess.page(tmp_path / "map.html")
    assert (tmp_path / "map.toml").read_text() == (tmp_path / "typed.toml").read_text()
    assert sections(tmp_path / "map.html") == sections(tmp_path / "typed.html")
    assert str(guess).startswith("Units and signs explain the readings.") and "Knee [deg]" in str(guess)
    assert len(repr(guess)) < 200 and list(guess.to_frame().index) == list(guess.columns)
    run = legid.read(log, guess.columns)
    assert np.ptp(run["q2_rad"]) == pytest.approx(np.ptp(np.radians(np.loadtxt(log, delimiter=";", skiprows=1)[:, 2])))


def test_amperes_without_a_scale_are_refused_in_python_too(log: Path) -> None:
    columns = {"q2_rad": {"name": "Knee [deg]", "unit": "deg"}, "tau2_nm": {"name": "Torque [Nm]", "unit": "A"}}
    with pytest.raises(legid.InputError, match="is in A and has no scale"):
        legid.read(log, columns)


def test_results_show_themselves_and_write_the_commands_pages(log: Path, tmp_path: Path, shell: Shell) -> None:
    run = legid.read(log, legid.guess(log).columns, rig=log.parent / "rig.toml")
    legid.export(run, tmp_path / "run.csv")
    shell("info", tmp_path / "run.csv")
    assert shell.out
    run = legid.load(tmp_path / "run.csv", log.parent / "rig.toml")
    found = legid.fit(run)
    model = legid.model(found)
    legid.save_model(model, tmp_path / "model.json")
    seen = legid.validate(model, run)
    files = tmp_path / "run.csv", "--rig", log.parent / "rig.toml", "--html"
    shell("fit", *files, tmp_path / "fit.html")
    assert str(found).splitlines()[0] == shell.out.splitlines()[0] == str(found.trust) and "m2*l1*lc2" in str(found)
    (one,) = document("validate", tmp_path / "model.json", *files, tmp_path / "validation.html")["runs"]
    said = shell.out
    assert str(seen).splitlines()[0] == said.splitlines()[0] and "SSE q2_rad" in str(seen)
    for result, page in ((found, "fit.html"), (seen, "validation.html")):
        result.page(tmp_path / f"python-{page}")
        title, *rest = sections(tmp_path / f"python-{page}")
        typed_title, *typed_rest = sections(tmp_path / page)
        assert rest[:20] == typed_rest[:20] and len(rest) > 20 and title.split()[0] == typed_title.split()[0]
    for shown in (run, found, seen, seen[0], model):
        assert len(repr(shown)) < 700 and len(str(shown)) < 3000, type(shown)
    assert one["initial_state"] == pytest.approx({"q1_rad": seen[0].q[0, 0], "q2_rad": seen[0].q[0, 1],
                                                  "q1d": seen[0].qd[0, 0], "q2d": seen[0].qd[0, 1]}, abs=1e-12)
    assert f"{seen[0].q[0, 1]:.5g}" in said.split("Initial states")[1]


def test_exports_are_the_commands(log: Path, tmp_path: Path) -> None:
    run = legid.read(log, legid.guess(log).columns, rig=log.parent / "rig.toml")
    model = legid.model(legid.fit(run))
    legid.save_model(model, tmp_path / "model.json")
    for name in ("leg.urdf", "leg.xml"):
        notes = legid.export(model, tmp_path / name).notes
        typed("export", tmp_path / "model.json", "--out", tmp_path / f"typed-{name}")
        assert (tmp_path / name).read_text() == (tmp_path / f"typed-{name}").read_text() and notes
    legid.export(model, tmp_path / "leg", "mujoco", starts=run)
    assert {path.name for path in (tmp_path / "leg").iterdir()} == {"leg.xml", "leg.py"}
    assert "<key" in (tmp_path / "leg/leg.xml").read_text()
    legid.export(run, tmp_path / "run.parquet")
    again = legid.load(tmp_path / "run.parquet", log.parent / "rig.toml")
    np.testing.assert_array_equal(again["q2_rad"], run["q2_rad"])
    legid.export(FIXTURES / "healthy.mcap", tmp_path / "healthy.mat")
    assert (tmp_path / "healthy.mat").stat().st_size > 1000


@pytest.mark.parametrize("out, to, options, told", [
    ("run.urdf", None, {}, "urdf is no format of a run"), ("run.abc", None, {}, "no ending that tells a format"),
    ("run.csv", None, {"samples": 3}, "--samples: is for --to mujoco"), ("r.mcap", None, {}, "give the paths of run")])
def test_an_export_that_cannot_be_is_refused(log: Path, tmp_path: Path, out: str, to: str | None,
                                             options: dict[str, Any], told: str) -> None:
    run = legid.read(log, legid.guess(log).columns)
    with pytest.raises(legid.InputError, match=re.escape(told)):
        legid.export(run, tmp_path / out, to, **options)
    assert not (tmp_path / out).exists()
