"""`legid diagnose --against` and `legid compare` of sessions: text, JSON, folders, and what they refuse."""

import gzip
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from daq import load_rig
from evidence.blind.stickslip import MAKERS
from experiments.models import load_model, save_model
from experiments.session import prepare
from experiments.workflows import as_reference
from tests.support.changed_leg import REFERENCE, leg_runs
from tests.support.models import write_model
from tests.support.packed_runs import stuck
from tests.support.pages import Outside
from tests.support.paths import REAL, ROOT
from tests.support.shell import Shell, document, read_json

RIG = ROOT / "studies/rigs/dfki_diagnose.toml"
ARM = REAL / "dfki_a0"


@pytest.mark.skipif(not ARM.is_dir(), reason="needs the real records next to the checkout")
def test_an_unchanged_arm_against_a_folder(tmp_path: Path, shell: Shell) -> None:
    for run in ("00", "02", "12"):
        shutil.copy(ARM / f"{run}.csv.gz", tmp_path)
    stuck(ARM / "02.csv.gz", tmp_path / "bad.csv.gz")
    found = document("diagnose", *(ARM / f"{run}.csv.gz" for run in ("01", "03")), "--against", tmp_path, "--rig", RIG)
    assert shell.out.startswith("No change: ")
    assert found["verdict"] == "no_change" and found["causes"] == []
    assert [run["run"] for run in found["set_aside"]] == ["reference bad.csv.gz"]
    assert [s["file"] for s in found["against"]["sources"]] == ["00.csv.gz", "02.csv.gz", "12.csv.gz", "bad.csv.gz"]
    assert all(len(s["sha256"]) == 64 for s in found["against"]["sources"])
    assert any(c["smallest_detectable"] for c in found["candidates"] if c["effect"] == "torque_delay")
    assert {n["effect"] for n in found["not_testable"]} >= {"encoder_offset"}


def test_a_model_is_as_good_a_reference_as_its_runs(here: Path, shell: Shell) -> None:
    files, rig = leg_runs(here, MAKERS["gyro_scale"][0](1.0))
    earlier, runs = files[:REFERENCE], files[REFERENCE : REFERENCE + 2]
    prepared = prepare(earlier, load_rig(rig))
    path = write_model(here / "model.json", [0.1] * prepared.setup.mechanism.p,
                       structs.asdict(prepared.setup.settings))
    words = "diagnose", *runs, "--rig", rig, "--against"
    assert "does not hold how much its runs scatter; give the runs" in shell.fails(*words, "model.json")
    model = structs.replace(load_model(path), gear_ratio=prepared.setup.gear_ratio)
    save_model(as_reference(model, prepared), path)
    first, second = (document(*words, *reference) for reference in (earlier, [path]))
    assert first["verdict"] == second["verdict"] and "gyro_scale" in {c["effect"] for c in first["causes"]}
    for one, other in zip(first["candidates"], second["candidates"], strict=True):
        assert (one["effect"], one["joint"]) == (other["effect"], other["joint"])
        assert other["change"] == pytest.approx(one["change"], rel=1e-6)
        assert other["p_value"] == pytest.approx(one["p_value"], rel=1e-6)
    assert first["held_out"]["gain"] == pytest.approx(second["held_out"]["gain"], rel=1e-6)
    assert second["against"]["sources"][0]["file"] == second["provenance"]["model"]["file"] == "model.json"
    broken = read_json(path)
    broken["reference"]["columns"][3] = "another"
    path.write_text(json.dumps(broken))
    assert "another library of effects" in shell.fails(*words, "model.json")
    assert "is not the only reference" in shell.fails(*words, "model.json", *earlier)
    rig.write_text(rig.read_text() + "\n[terms]\nencoder_zero = [2]\n")
    assert "does not hold the encoders' zeros" in shell.fails(*words, "model.json")


def late(source: Path, target: Path, seconds: float) -> None:
    """A run whose torques are late."""
    rows = [line.split(",") for line in gzip.decompress(source.read_bytes()).decode().splitlines()]
    values = np.array(rows[1:], dtype=float)
    time = values[:, rows[0].index("time_s")].copy()
    for k, name in enumerate(rows[0]):
        if name.startswith("tau"):
            values[:, k] = np.interp(time - seconds, time, values[:, k])
    lines = [",".join(rows[0]), *(",".join(map(repr, map(float, row))) for row in values)]
    target.write_bytes(gzip.compress("\n".join(lines).encode()))


@pytest.mark.skipif(not ARM.is_dir(), reason="needs the real records next to the checkout")
def test_sessions_as_folders_and_as_runs(here: Path, shell: Shell) -> None:
    before, after = here / "before", here / "after"
    before.mkdir()
    after.mkdir()
    first = [shutil.copy(ARM / f"{run}.csv.gz", before) for run in ("00", "02")]
    plain = [ARM / f"{run}.csv.gz" for run in ("01", "03")]
    for run in plain:
        late(run, after / run.name, 0.02)
    page = here / "page.html"
    found = document("compare before after --rig", RIG, "--html page.html")
    said = shell.out
    assert said.startswith("Different: torque_delay, delay 0.0") and "\n\nFrom before to after:" in said
    (pair,), files = found["pairs"], found["provenance"]["runs"]
    assert found["schema"] == "legid.sessions/1" and len(files) == 4
    assert pair["a"] == {"name": "before", "runs": ["before 00.csv.gz", "before 02.csv.gz"]}
    (cause,) = pair["causes"]
    assert (cause["effect"], cause["kind"]) == ("torque_delay", "timing")
    assert 0.01 < cause["size"][0]["ci95"][0] < 0.02 < cause["size"][0]["ci95"][1] < 0.03
    html = page.read_text()
    assert "From before to after" in html and "Next step: Check both clocks" in html and html.count("<svg") == 1
    outside = Outside()
    outside.feed(html)
    assert outside.found == [] and outside.scripts == 0
    shell("compare", *first, "--with", *plain, "--with after --rig", RIG)
    rows = [line.split()[:3] for line in shell.out.splitlines()]
    assert ["A", "B", "no_change"] in rows and ["A", "C", "named"] in rows


def test_references_and_sessions_that_are_none_are_refused(tmp_path: Path, shell: Shell) -> None:
    against, compare = "diagnose r.csv --against", "compare"
    for words, said in (([against, tmp_path], "holds no run file"), ([against, "model.json"], "No such file"),
                        ([against, "a.csv --fix beta1=1"], "does not go with --against"),
                        ([compare, "a.csv b.csv"], "is neither a model nor a folder"),
                        ([compare, tmp_path], "is the only session"),
                        ([compare, "a.json b.json"], "needs a second model and runs after it"),
                        ([compare, "a.json b.json r.csv --workers 2"], "belongs to a comparison of sessions"),
                        ([compare, tmp_path, tmp_path, "--horizons 1"], "belongs to a comparison of models")):
        assert said in shell.fails(*words, "--rig", RIG)
