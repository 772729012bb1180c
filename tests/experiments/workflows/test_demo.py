"""The demo end to end: what it says, its files, documents by their schemas."""

import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

from experiments.excite import random_multisine
from experiments.models import load_model
from tests.support.pages import allowed_script
from tests.support.shell import Shell, document, read_json, typed, values


@pytest.fixture(scope="module")
def demo(module_path: Path) -> Path:
    """What a demo of four short runs leaves behind, and `said.txt` for what it printed."""
    with redirect_stdout(StringIO()) as said:
        typed("demo --seconds 6 --runs 4 --effect torque_offset --out", module_path)
    (module_path / "said.txt").write_text(said.getvalue())
    return module_path


@pytest.mark.slow
def test_it_says_what_was_hidden_what_was_found_and_where_it_is(demo: Path) -> None:
    said = (demo / "said.txt").read_text()
    assert "Hidden in it: a shunt that reads 0.04 N m too much." in said
    assert read_json(demo / "diagnosis.json")["sentence"] in said
    for name in ("report.html", "fit.html", "model.json", "extended.json", "fit.json", "diagnosis.json",
                 "validation.json", "rig.toml", "demo-run*.mcap"):
        assert str(demo / name) in said
    assert re.search(r"\d of 9 parameters of the plant lie inside", said)
    assert {f"demo-run{k}.mcap" for k in (1, 2, 3, 4)} <= {path.name for path in demo.iterdir()}


@pytest.mark.slow
def test_documents_follow_their_schemas(demo: Path) -> None:
    fit = read_json(demo / "fit.json")
    assert fit["schema"] == "legid.fit/1" and fit["converged"] and len(fit["parameters"]) == 9
    model = load_model(demo / "model.json")
    assert model.provenance.runs == ("demo-run1.mcap", "demo-run2.mcap", "demo-run3.mcap") and not model.effects
    assert [p.value for p in model.parameters] == pytest.approx(values(fit))
    found = read_json(demo / "diagnosis.json")
    assert found["schema"] == "legid.diagnosis/1" and found["runs"]["confirm"] == ["demo-run4.mcap"]
    extended = load_model(demo / "extended.json")
    assert {e.name for e in extended.effects} <= {cause["effect"] for cause in found["causes"]}
    (run,) = read_json(demo / "validation.json")["runs"]
    assert run["run"] == "demo-run4.mcap" and not run["diverged"]
    assert run["rmse"]["q1_rad"] < 0.05 and run["rmse"]["q2_rad"] < 0.1


@pytest.mark.slow
def test_fit_report_shows_figures_4_and_5_and_the_validation(demo: Path) -> None:
    page = (demo / "fit.html").read_text()
    for words in ("Parameters", "Against the truth", "Accelerometer and gyro", "it must be zero", "wls (encoder)",
                  "Free-run simulation against validation data", "Noise levels", "What is not determined"):
        assert words in page
    assert page.count("<svg") == 13 and "http-equiv" in page and allowed_script(page)


@pytest.mark.slow
def test_report_tells_what_was_hidden(demo: Path) -> None:
    page = (demo / "report.html").read_text()
    for words in ("In addition to its rig file it had a shunt that reads 0.04 N m too much", "Against the truth",
                  "Candidates", "What cannot be tested here"):
        assert words in page
    assert allowed_script(page)


@pytest.mark.slow
def test_fit_and_validate_work_on_its_files(demo: Path, here: Path, shell: Shell) -> None:
    found = document("fit", demo / "demo-run1.mcap", "--rig", demo / "rig.toml",
                     "--model-out m.json --html f.html --fix beta9=0.04")
    assert "given" in shell.out
    rows = {p["name"]: p for p in found["parameters"]}
    assert rows["beta9"]["value"] == 0.04 and rows["beta9"]["fixed"]
    found = document("validate m.json", demo / "demo-run3.mcap", "--rig", demo / "rig.toml", "--html v.html")
    assert found["schema"] == "legid.validation/1"
    assert "demo-run3.mcap" in (here / "v.html").read_text()


def test_the_plan_is_drawn_from_the_seed() -> None:
    a, b, c = (random_multisine(seed, 20.0, 0.7) for seed in (1, 1, 2))
    assert (a.torque_nm == b.torque_nm).all() and not (a.torque_nm == c.torque_nm).all()
    assert a.peak_nm == pytest.approx(0.7) and a.torque_nm[0] == 0.0 and a.duration_s == pytest.approx(20.0)
    with pytest.raises(ValueError, match="too short"):
        random_multisine(1, 2.0, 0.7)
