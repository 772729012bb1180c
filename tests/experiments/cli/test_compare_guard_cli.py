"""`compare` warns on runs that a model was fitted to, and takes a published model that has no covariance."""

import json
from pathlib import Path

import pytest

from tests.support.prescribed import ARM_RIG, arm_run, written
from tests.support.shell import Shell, read_json, typed


@pytest.fixture(scope="module")
def folder(module_path: Path) -> Path:
    (module_path / "rig.toml").write_text(ARM_RIG)
    written([arm_run(0, seconds=8.0), arm_run(1, seconds=8.0)], module_path)
    return module_path


def command(folder: Path, *words: object) -> None:
    typed(*words, "--rig", folder / "rig.toml")


def test_a_model_of_one_run_is_not_judged_on_it_silently(folder: Path, shell: Shell) -> None:
    one, other = sorted(folder.glob("*.csv"))
    diagnosed, fitted = folder / "d.json", folder / "f.json"
    command(folder, "diagnose", one, "--model-out", diagnosed, "--workers 1")
    command(folder, "fit", other, "--model-out", fitted)
    provenance = read_json(diagnosed)["provenance"]
    assert provenance["runs"] == [one.name] == [run["file"] for run in provenance["origin"]["runs"]]
    shell.read()
    command(folder, "compare", diagnosed, fitted, one)
    assert f"d.json was fitted to {one.name}" in shell.out


def test_a_published_model_has_no_covariance(folder: Path, shell: Shell) -> None:
    one, other = sorted(folder.glob("*.csv"))
    fitted, published = folder / "f2.json", folder / "p.json"
    command(folder, "fit", one, "--model-out", fitted)
    document = read_json(fitted)
    document["covariance"], document["ci95"] = None, []
    document["provenance"] |= {"runs": [], "origin": None}
    published.write_text(json.dumps(document))
    command(folder, "validate", published, other)
    shell.read()
    command(folder, "compare", published, fitted, other)
    assert "p.json does not say which runs it was fitted to" in shell.out
