"""`legid diagnose --against`: text, JSON, folders, and what it refuses."""

import json
import shutil
from pathlib import Path

import pytest

from experiments import cli
from tests.support.paths import REAL, ROOT

RIG = str(ROOT / "experiments/studies/rigs/dfki_diagnose.toml")
ARM = REAL / "dfki_a0"


@pytest.mark.skipif(not ARM.is_dir(), reason="needs the real records beside the checkout")
def test_an_unchanged_arm_against_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for run in ("00", "02", "12"):
        shutil.copy(ARM / f"{run}.csv.gz", tmp_path)
    out = tmp_path / "change.json"
    runs = [str(ARM / f"{run}.csv.gz") for run in ("01", "03")]
    assert cli.main(["diagnose", *runs, "--against", str(tmp_path), "--rig", RIG, "--json", str(out)]) == 0
    assert capsys.readouterr().out.startswith("No change: ")
    found = json.loads(out.read_text())
    assert found["verdict"] == "no_change" and found["causes"] == []
    assert [s["file"] for s in found["against"]["sources"]] == ["00.csv.gz", "02.csv.gz", "12.csv.gz"]
    assert all(len(s["sha256"]) == 64 for s in found["against"]["sources"])
    assert any(c["smallest_detectable"] for c in found["candidates"] if c["effect"] == "torque_delay")
    assert {n["effect"] for n in found["not_testable"]} >= {"encoder_offset"}


def test_an_empty_folder_a_model_and_a_page_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for more, words in ((["--against", str(tmp_path)], "holds no run file"),
                        (["--against", "model.json"], "is no run"),
                        (["--against", "a.csv", "--html", str(tmp_path / "p.html")], "does not go with --against")):
        assert cli.main(["diagnose", "r.csv", *more, "--rig", RIG]) == 2
        error = capsys.readouterr().err
        assert words in error and "Traceback" not in error
