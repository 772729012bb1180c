"""Results name the files behind them and what was missing of those; the rig comes from where it is known."""

import shutil
from pathlib import Path

import pytest

from experiments.provenance import commit, read_origin, source_of
from tests.support.paths import DEMO_RIG as RIG
from tests.support.shell import Shell, document, read_json, typed


@pytest.fixture(scope="module")
def folder(demo_run: Path, module_path: Path) -> Path:
    """A run of five seconds with everything that a fit writes of it, its rig taken from the run."""
    shutil.copy(demo_run, module_path)
    typed("fit", module_path / "run.mcap", "--method wls --json", module_path / "fit.json", "--html",
          module_path / "fit.html", "--model-out", module_path / "model.json")
    return module_path


@pytest.mark.parametrize("name", ["fit.json", "fit.html", "model.json"])
def test_every_result_names_its_files_and_verify_finds_them_changed(name: str, folder: Path, tmp_path: Path,
                                                                    shell: Shell) -> None:
    origin = read_origin(folder / name)
    assert origin.commit == commit() and origin.version
    assert origin.runs == (source_of(folder / "run.mcap"),)
    assert (origin.rig.file, origin.rig.inside) == ("rig.toml", "run.mcap")
    shell("verify", folder / name)
    said = shell.out
    assert said.count("same") == 2 and "CHANGED" not in said
    data = (folder / "run.mcap").read_bytes()
    (tmp_path / "run.mcap").write_bytes(data[:-9] + bytes(9))
    assert "run.mcap (CHANGED)" in shell.fails("verify", folder / name, tmp_path, status=1)
    (tmp_path / "run.mcap").unlink()
    assert "run.mcap (missing)" in shell.fails("verify", folder / name, tmp_path, status=1)


@pytest.mark.parametrize("command, read", [
    ("runs . --json", {"run.mcap"}), ("runs run.mcap --json", {"run.mcap"}), ("effects --json", set()),
    ("monte-carlo biped3 --runs 2 --cases 1 --methods wls --workers 1 --json", set())])
def test_every_other_document_says_what_it_was_made_from(command: str, read: set[str], folder: Path,
                                                         tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                         shell: Shell) -> None:
    shutil.copy(folder / "run.mcap", tmp_path)
    monkeypatch.chdir(tmp_path)
    shell(command, "out.json")
    origin = read_origin("out.json")
    assert {source.file for source in origin.sources} == read and origin.commit == commit()
    assert origin.command.startswith(f"legid {command.split()[0]}")
    assert (origin.seed is not None) == ("biped3" in command)
    shell("verify out.json")


@pytest.mark.parametrize("text", ["words", "{}", "[1]", '{"provenance": {"runs": "x"}}', "[" * 100_000])
def test_a_file_without_provenance_is_no_crash(text: str, here: Path, shell: Shell) -> None:
    (here / "x.json").write_text(text)
    assert "says nothing of the files" in shell.fails("verify x.json")


def test_a_damaged_run_is_used_only_when_asked_for_and_the_documents_say_so(
        folder: Path, here: Path, shell: Shell) -> None:
    cut = here / "cut.mcap"
    cut.write_bytes((folder / "run.mcap").read_bytes()[:-3000])
    for command in (["fit", cut, "--method wls"], ["diagnose", cut], ["validate", folder / "model.json", cut],
                    ["export", cut, "--out", here / "cut.csv"]):
        shell(*command, status=2)
        error = shell.err.splitlines()[-1]
        assert "its end is missing" in error and "--damaged" in error
    assert not (here / "cut.csv").exists()
    shell("info cut.mcap")
    assert "DAMAGED: its end is missing" in shell.out
    found = document("fit cut.mcap --method wls --damaged --fix beta8=0 --model-out model.json")
    assert [d["run"] for d in found["damaged"]] == ["cut.mcap"]
    assert read_json(folder / "fit.json")["damaged"] == []
    shell("recover cut.mcap")
    shell("export cut.recovered.mcap --out saved.csv")


def test_the_rig_of_the_run_is_compared_with_the_one_given(
        folder: Path, here: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell) -> None:
    other = here / "rig.toml"
    other.write_text(RIG.read_text().replace("lever_arm_m = 0.2", "lever_arm_m = 0.1"))
    shell("fit", folder / "run.mcap", "--method wls --rig rig.toml")
    said = shell.out
    assert "run.mcap was recorded with imu.lever_arm_m = 0.2" in said and "says 0.1" in said
    monkeypatch.chdir(here)
    shutil.copy(folder / "run.mcap", here / "run.mcap")
    shell("fit run.mcap --method wls")
    assert "rig: the one that run.mcap holds" in shell.err
    shell("validate", folder / "model.json", "none.csv --quiet", status=2)
    assert "none.csv" in shell.err  # ./rig.toml was taken, the run is what is missing
    other.unlink()
    assert "--rig: is not given" in shell.fails("fit none.csv")
