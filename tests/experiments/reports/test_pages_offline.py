"""Every HTML page that the program writes, opened from the disk in a real browser: nothing fetched, nothing wrong."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from daq.recording.plan import write_plan
from daq.rig import load_rig
from experiments import cli
from experiments.emulation.plant import LegBody
from experiments.excite.multisine import random_multisine
from experiments.models.mechanism_settings import mechanism_settings
from experiments.models.model_file import save_model
from experiments.reports.diagnosis_page import diagnosis_sections, write_diagnosis
from experiments.reports.fit_json import model_of
from experiments.reports.fit_page import fit_sections, fit_summary, truth_section
from experiments.reports.html import Section, write_page
from experiments.studies.casebook import Diagnosed, DiagnoseTask, FitTask, Fitted, Study, load_cases
from experiments.studies.casebook_page import write_casebook
from tests.support.diagnoses import synthetic
from tests.support.fits import estimates, synthetic_fit
from tests.support.live_browser import CHROMIUM, DRIVER, LAPTOP, PHONE, Browser
from tests.support.paths import DEMO_RIG as RIG

pytestmark = pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="no chromium with its chromedriver here")
PAGES = ("fit", "diagnosis", "validation", "casebook", "study", "demo")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One page of each kind, by what writes them for a user."""
    out = tmp_path_factory.mktemp("pages")
    result, found = synthetic_fit(), synthetic()
    write_page(out / "fit.html", "Fit of leg2: run1.mcap", fit_summary(result, "leg2"), fit_sections(result))
    write_diagnosis(out / "diagnosis.html", found, "leg2")
    truth = dict(zip(result.mechanism.names, LegBody().beta()))
    write_page(out / "demo.html", "The emulated leg: a cause is named", found.sentence,
               [Section("What was hidden", ["Something."]), *diagnosis_sections(found),
                truth_section(result.mechanism, estimates(result), truth), *fit_sections(result)])
    fit = FitTask(title="all", rig="r.toml", runs=("a.csv",), published=dict(zip(result.mechanism.names, result.beta)))
    diagnose = DiagnoseTask(rig="r.toml", runs=("a.csv",), expected=("stribeck_friction",))
    write_casebook(out / "casebook.html", [Study(load_cases()[0], [Fitted(fit, result, "")], [],
                                                 [Diagnosed(diagnose, found, "")])])
    save_model(model_of(result, mechanism_settings(load_rig(RIG)), "zero", ["a"]), out / "model.json")
    write_plan(random_multisine(1, 5.0, 0.3), out / "plan.csv")
    run(out, "simulate", "model.json", "--plan", "plan.csv", "--out", "run.csv", "--noise-seed", "1")
    run(out, "validate", "model.json", "run.csv", "--rig", str(RIG), "--html", "validation.html")
    run(out, "monte-carlo", "biped3", "--runs", "3", "--cases", "1", "--methods", "wls", "--workers", "1", "--out",
        "study")
    (out / "study" / "report.html").rename(out / "study.html")
    return out


def run(folder: Path, *arguments: str) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert cli.main(arguments) == 0


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    browser = Browser()
    yield browser
    browser.close()


@pytest.mark.parametrize("name", PAGES)
def test_a_page_from_the_disk_fetches_nothing_and_fits(folder: Path, browser: Browser, name: str) -> None:
    url = (folder / f"{name}.html").as_uri()
    browser.collect()
    browser.requests.clear()
    for size in (LAPTOP, PHONE):
        browser.resize(size)
        browser.driver.get(url)
        assert browser.js("document.querySelectorAll('h2').length") > 0
        assert browser.sideways() <= 0
        drawn = browser.js("[...document.querySelectorAll('figure svg')].map(s => s.getBoundingClientRect().width)")
        assert drawn and np.min(drawn) > 200
    browser.collect()
    assert {request for request in browser.requests if not request.startswith("data:")} == {url}
    assert browser.complaints() == []


def test_a_page_that_does_otherwise_is_noticed(tmp_path: Path, browser: Browser) -> None:
    (tmp_path / "bad.html").write_text("<h2>x</h2><img src='http://192.0.2.1/x.png'><script>nothing.at.all</script>")
    browser.collect()
    browser.console.clear()
    browser.driver.set_page_load_timeout(5)
    try:
        browser.driver.get((tmp_path / "bad.html").as_uri())
    except Exception as error:
        assert "timeout" in str(error).lower()
    assert browser.outgoing() == ["http://192.0.2.1/x.png"]
    assert any("nothing is not defined" in line for line in browser.complaints())
