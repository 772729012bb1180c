"""`compare` warns on runs that a model was fitted to, and takes a published model that has no covariance."""

import json
from pathlib import Path

import pytest

from experiments.cli import main
from tests.support.prescribed import ARM_RIG, arm_run, written
from tests.support.shell import Shell


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("guard")
    (path / "rig.toml").write_text(ARM_RIG)
    written([arm_run(0, seconds=8.0), arm_run(1, seconds=8.0)], path)
    return path


def command(folder: Path, *words: str) -> int:
    return main([*words, "--rig", str(folder / "rig.toml")])


def test_a_model_of_one_run_is_not_judged_on_it_silently(folder: Path, shell: Shell) -> None:
    one, other = sorted(map(str, folder.glob("*.csv")))
    diagnosed, fitted = str(folder / "d.json"), str(folder / "f.json")
    assert command(folder, "diagnose", one, "--model-out", diagnosed, "--workers", "1") == 0
    assert command(folder, "fit", other, "--model-out", fitted) == 0
    provenance = json.loads(Path(diagnosed).read_text())["provenance"]
    assert provenance["runs"] == [Path(one).name] == [run["file"] for run in provenance["origin"]["runs"]]
    shell.read()
    assert command(folder, "compare", diagnosed, fitted, one) == 0
    assert f"d.json was fitted to {Path(one).name}" in shell.out


def test_a_published_model_has_no_covariance(folder: Path, shell: Shell) -> None:
    one, other = sorted(map(str, folder.glob("*.csv")))
    fitted, published = str(folder / "f2.json"), folder / "p.json"
    assert command(folder, "fit", one, "--model-out", fitted) == 0
    document = json.loads(Path(fitted).read_text())
    document["covariance"], document["ci95"] = None, []
    document["provenance"] |= {"runs": [], "origin": None}
    published.write_text(json.dumps(document))
    assert command(folder, "validate", str(published), other) == 0
    shell.read()
    assert command(folder, "compare", str(published), fitted, other) == 0
    assert "p.json does not say which runs it was fitted to" in shell.out
