"""Results name the files behind them and what was missing or faulty in those; the rig comes from where it is known."""

import json
import shutil
from pathlib import Path

import pytest

import legid
from experiments.provenance import commit, read_origin, source_of
from tests.support.driven_pendulum import pendulum_run
from tests.support.imported_files import table_of
from tests.support.paths import DEMO_RIG as RIG
from tests.support.prescribed import ARM_RIG, arm_run, written
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
                                                         here: Path,
                                                         shell: Shell) -> None:
    shutil.copy(folder / "run.mcap", here)
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
        folder: Path, here: Path, shell: Shell) -> None:
    other = here / "rig.toml"
    other.write_text(RIG.read_text().replace("lever_arm_m = 0.2", "lever_arm_m = 0.1"))
    shell("fit", folder / "run.mcap", "--method wls --rig rig.toml")
    said = shell.out
    assert "run.mcap was recorded with imu.lever_arm_m = 0.2" in said and "says 0.1" in said
    shutil.copy(folder / "run.mcap", here / "run.mcap")
    shell("fit run.mcap --method wls")
    assert "rig: the one that run.mcap holds" in shell.err
    shell("validate", folder / "model.json", "none.csv --quiet", status=2)
    assert "none.csv" in shell.err  # ./rig.toml was taken, the run is what is missing
    other.unlink()
    assert "--rig: is not given" in shell.fails("fit none.csv")


JOINT_RIG = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n'


def test_every_document_has_the_faulty_readings(here: Path) -> None:
    runs, rig = [], here / "rig.toml"
    for k in range(3):
        run = pendulum_run("r", k)
        run["q1_rad"][len(run) // 2] += 2.0 * (k == 1)
        runs.append(table_of(run, here / f"r{k}.csv"))
    rig.write_text(JOINT_RIG)
    words = *runs, "--rig", rig
    read = document("fit", *words, "--model-out model.json")["readings"]
    (fault,) = read
    assert (fault["run"], fault["column"], fault["what"], fault["done"]) == ("r1.csv", "q1_rad", "isolated", "left_out")
    assert document("validate model.json", *words)["readings"] == read
    assert document("diagnose", *words, "--workers 1")["readings"] == read
    diagnosis = legid.diagnose(legid.load(runs, rig))
    assert diagnosis.document["readings"] == read
    diagnosis.page(here / "d.html")
    assert "off in one reading" in (here / "d.html").read_text() and len(repr(diagnosis)) < 400


@pytest.fixture(scope="module")
def arm(module_path: Path) -> Path:
    (module_path / "rig.toml").write_text(ARM_RIG)
    written([arm_run(0, seconds=8.0), arm_run(1, seconds=8.0)], module_path)
    return module_path


def command(arm: Path, *words: object) -> None:
    typed(*words, "--rig", arm / "rig.toml")


def test_a_model_of_one_run_is_not_judged_on_it_silently(arm: Path, shell: Shell) -> None:
    one, other = sorted(arm.glob("*.csv"))
    diagnosed, fitted = arm / "d.json", arm / "f.json"
    command(arm, "diagnose", one, "--model-out", diagnosed, "--workers 1")
    command(arm, "fit", other, "--model-out", fitted)
    provenance = read_json(diagnosed)["provenance"]
    assert provenance["runs"] == [one.name] == [run["file"] for run in provenance["origin"]["runs"]]
    shell.read()
    command(arm, "compare", diagnosed, fitted, one)
    assert f"d.json was fitted to {one.name}" in shell.out


def test_a_published_model_has_no_covariance(arm: Path, shell: Shell) -> None:
    one, other = sorted(arm.glob("*.csv"))
    fitted, published = arm / "f2.json", arm / "p.json"
    command(arm, "fit", one, "--model-out", fitted)
    document = read_json(fitted)
    document["covariance"], document["ci95"] = None, []
    document["provenance"] |= {"runs": [], "origin": None}
    published.write_text(json.dumps(document))
    command(arm, "validate", published, other)
    shell.read()
    command(arm, "compare", published, fitted, other)
    assert "p.json does not say which runs it was fitted to" in shell.out
