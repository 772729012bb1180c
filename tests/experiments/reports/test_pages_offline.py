"""Every HTML page that the program writes, opened from the disk in a real browser: nothing fetched, nothing wrong."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq import load_rig
from daq.recording import write_plan
from estimator import RunAgreement
from experiments.documents import DiagnosisDocument
from experiments.emulation import LegBody
from experiments.excite import random_multisine
from experiments.judge import estimates_of, model_of
from experiments.models import mechanism_settings, save_model
from experiments.provenance import origin_of
from experiments.reports import (
    BLUE,
    Line,
    Picture,
    Section,
    Table,
    diagnosis_sections,
    fit_summary,
    picture_lines,
    truth_section,
    write_diagnosis,
    write_page,
)
from experiments.reports.run_agreement import MOST_RUNS
from experiments.session import prepare
from studies.casebook import Diagnosed, DiagnoseTask, FitTask, Fitted, Study, load_cases
from studies.casebook_page import write_casebook
from tests.support.diagnoses import synthetic
from tests.support.fits import document_of, sections_of, synthetic_fit
from tests.support.live_browser import LAPTOP, PHONE, Browser, needs_browser
from tests.support.paths import DEMO_RIG as RIG
from tests.support.paths import FIXTURES
from tests.support.shell import typed

pytestmark = needs_browser
WIDTHS = ("[...document.querySelectorAll('figure')].map(f => "
          "(f.querySelector('canvas') ?? f.querySelector('svg')).getBoundingClientRect().width)")
"""Of what each figure shows."""
UNFOLD = "document.querySelectorAll('details').forEach(e => { e.open = true })"
PAGES = ("fit", "diagnosis", "validation", "casebook", "study", "demo")


@pytest.fixture(scope="module")
def folder(module_path: Path) -> Path:
    """One page of each kind, by what writes them for a user."""
    out = module_path
    result, found = synthetic_fit(), synthetic()
    write_page(out / "fit.html", "Fit of leg2: run1.mcap", fit_summary(document_of(result)),
               sections_of(result))
    prepared = prepare([FIXTURES / "healthy.mcap"], load_rig(RIG))
    document = DiagnosisDocument.of(found, prepared.set_aside, prepared.setup.datasets, "leg2")
    document.provenance = origin_of([FIXTURES / "healthy.mcap"])
    write_diagnosis(out / "diagnosis.html", document, found)
    truth = dict(zip(result.mechanism.names, LegBody().beta()))
    write_page(out / "demo.html", "The emulated leg: a cause is named", found.sentence,
               [Section("What was hidden", ["Something."]), *diagnosis_sections(document, found),
                truth_section(result.mechanism, estimates_of(result), truth),
                *sections_of(result)])
    fit = FitTask(title="all", rig="r.toml", runs=("a.csv",), published=dict(zip(result.mechanism.names, result.beta)))
    diagnose = DiagnoseTask(rig="r.toml", runs=("a.csv",), expected=("stribeck_friction",))
    write_casebook(out / "casebook.html", [Study(load_cases()[0], [Fitted(fit, result, "")], [],
                                                 [Diagnosed(diagnose, found, "")])])
    save_model(model_of(result, mechanism_settings(load_rig(RIG)), "zero", ["a"]), out / "model.json")
    write_plan(random_multisine(1, 5.0, 0.3), out / "plan.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(out)
        typed("simulate model.json --plan plan.csv --out run.csv --noise-seed 1")
        typed("validate model.json run.csv --html validation.html --rig", RIG)
        typed("monte-carlo biped3 --runs 3 --cases 1 --methods wls --workers 1 --out study")
    (out / "study/report.html").rename(out / "study.html")
    return out


def unscripted(page: Path) -> Path:
    """The same page without its scripts."""
    out = page.with_name("unscripted.html")
    out.write_text(re.sub("<script.*?</script>", "", page.read_text(), flags=re.DOTALL))
    return out


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    browser = Browser()
    yield browser
    browser.close()


@pytest.mark.parametrize("name", PAGES)
def test_a_page_from_the_disk_fetches_nothing_and_fits(folder: Path, browser: Browser, name: str) -> None:
    page = folder / f"{name}.html"
    browser.collect()
    browser.requests.clear()
    for size in (LAPTOP, PHONE):
        browser.show(page, size)
        assert browser.js("document.querySelectorAll('h2').length") > 0
        browser.js(UNFOLD)
        assert browser.sideways() <= 0
        drawn = browser.js(WIDTHS)
        assert drawn and np.min(drawn) > 200
    browser.collect()
    assert {request for request in browser.requests if not request.startswith("data:")} == {page.as_uri()}
    assert browser.complaints() == []


def test_figures_zoom_together_and_are_pictures_on_paper_and_without_scripts(folder: Path, browser: Browser) -> None:
    browser.show(folder / "fit.html")
    shown = "[...document.querySelectorAll('.plot canvas, .chart > svg')].map(e => [e.tagName, e.offsetWidth ?? " \
            "e.getBoundingClientRect().width])"
    labels = "[...document.querySelectorAll('.plot .u-legend')].map(e => e.querySelector('.u-value').textContent)"
    x, y, width = browser.js("(b => { b.scrollIntoView({block: 'center'}); const r = b.getBoundingClientRect(); "
                             "return [r.x, r.y + r.height / 2, r.width] })(document.querySelector('.u-over'))")
    def mouse(kind: str, at: float, button: str = "left") -> None:
        browser.cdp("Input.dispatchMouseEvent", type=kind, x=x + at * width, y=y, button=button, clickCount=1)

    def times() -> list[float]:
        mouse("mouseMoved", 0.999, "none")
        return [float(text) for text in browser.wait(
            lambda: "–" not in "".join(browser.js(labels)) and browser.js(labels), "values under the mouse")]

    before = times()
    assert len(before) == 5 and np.ptp(before) == 0.0 and before[0] == pytest.approx(15.0, abs=0.2)
    mouse("mousePressed", 0.2)
    mouse("mouseMoved", 0.4)
    mouse("mouseReleased", 0.4)
    browser.wait(lambda: times()[-1] < 6.5, "the other figures follow")
    assert np.ptp(times()) < 0.05 and times()[0] == pytest.approx(6.0, abs=0.3)
    for media in ("print", ""):
        browser.media(media)
        sizes = browser.js(shown)
        paper = [size for name, size in sizes if name == "svg"]
        screen = [size for name, size in sizes if name == "CANVAS"]
        assert (min(paper[:3]) > 100 and max(screen) == 0) if media else (
            max(paper[:3]) == 0 and min(screen) > 200), (media, sizes)
    # The browser's own switch for scripts races with the page's load, so the page goes without them.
    browser.show(unscripted(folder / "fit.html"))
    assert np.min(browser.js("[...document.querySelectorAll('figure svg')].map(s => s.getBoundingClientRect().width)")
                  ) > 200
    assert browser.complaints() == []


def test_two_fingers_zoom_and_two_taps_show_all(folder: Path, browser: Browser) -> None:
    browser.show(folder / "diagnosis.html", PHONE)
    shown = ("(o => [...document.querySelectorAll('.plot .uplot')].length)()", "uPlot.sync('run').plots"
             ".map(u => [u.scales.x.min, u.scales.x.max])")
    browser.js("document.querySelector('.u-over').scrollIntoView({block: 'center'})")

    def touch(kind: str, *at: float) -> None:
        browser.touch(kind, ".u-over", *at)

    whole = browser.js(shown[1])
    assert browser.js(shown[0]) == len(whole) and np.ptp(whole, axis=0).max() == 0.0
    touch("Start", 0.45, 0.55)
    touch("Move", 0.3, 0.7)
    touch("Move", 0.05, 0.95)
    touch("End")
    near = np.array(browser.wait(lambda: [s for s in browser.js(shown[1]) if s != whole[0]], "the figures zoom"))
    assert len(near) == len(whole) and np.ptp(near, axis=0).max() == 0.0
    assert np.ptp(near[0]) == pytest.approx(np.ptp(whole[0]) / 9.0, rel=0.1)
    for _ in range(2):
        touch("Start", 0.5)
        touch("End")
    browser.wait(lambda: browser.js(shown[1]) == whole, "all is shown again")


def test_errors_have_axes_of_their_own_below(folder: Path, browser: Browser) -> None:
    browser.show(folder / "diagnosis.html")

    def drawn() -> list[list[str]]:
        found: list[list[str]] = browser.js(
            "[...document.querySelectorAll('figure.chart')].map(f => [...f.querySelectorAll('.u-legend')]"
            ".map(l => l.textContent))")
        return found if all(found) else []

    labels = browser.wait(drawn, "the figures are drawn")
    assert labels
    for upper, lower in labels:
        assert "less measured" not in upper and lower.count("less measured") == 2


def test_folded_sections_open_by_hand_by_a_link_and_on_paper(folder: Path, browser: Browser) -> None:
    """Without any script: rows of tables in folded sections have no height until then."""
    page = unscripted(folder / "diagnosis.html")
    seen = "[...document.querySelectorAll('details tbody tr')].filter(e => e.checkVisibility({contentVisibilityAuto: " \
           "true})).length"
    rows = "document.querySelectorAll('details tbody tr').length"
    browser.show(page)
    assert browser.js(rows) > 20 and browser.js(seen) == 0
    browser.media("print")
    browser.wait(lambda: browser.js(seen) == browser.js(rows), "paper shows all")
    browser.media("")
    browser.wait(lambda: browser.js(seen) == 0, "the screen shows none")
    browser.js("document.querySelector('details:has(tbody) > summary').click()")
    browser.wait(lambda: 0 < browser.js(seen) < browser.js(rows), "one section opens")
    (anchor,) = re.findall(r'id="(s\d+-candidates)"', page.read_text())
    browser.driver.get(f"{page.as_uri()}#{anchor}")
    browser.wait(lambda: browser.js(f"document.getElementById('{anchor}').parentElement.open"), "the section opens")


def test_many_runs_that_disagree_stay_within_the_page(tmp_path: Path, browser: Browser) -> None:
    plain, runs = synthetic_fit(), tuple(f"recording-{k}.mcap" for k in range(MOST_RUNS))
    p = plain.mechanism.p
    agreement = RunAgreement(runs, 1e-4, plain.std, True, np.full(p, 2.4), plain.beta, np.full(p, 1.234e-4),
                             np.tile(plain.beta, (len(runs), 1)), np.ones(p, dtype=bool))
    found = replace(plain, agreement=agreement)
    write_page(tmp_path / "fit.html", "Fit", "", sections_of(found))
    for width in (1400, 1180, 1130, 900):
        browser.show(tmp_path / "fit.html", (width, 900))
        over = browser.js("Math.max(...[...document.querySelectorAll('table')].map(t => "
                          "t.getBoundingClientRect().right - t.parentElement.getBoundingClientRect().right))")
        assert over <= 0.5, width
    browser.resize((680, 900))
    browser.media("print")
    lines = browser.js("[...document.querySelectorAll('td.unit')].map(cell => { const r = document.createRange(); "
                       "r.selectNodeContents(cell); return r.getClientRects().length })")
    browser.media("")
    assert lines and max(lines) == 1


def test_axes_have_different_marks_whatever_the_size_of_the_values(tmp_path: Path, browser: Browser) -> None:
    """An error of 10 microradians had an axis of zeros alone, and one just below a mark the single mark 0."""
    t = np.arange(1000) / 100.0
    for size in (3e-9, 1e-5, 0.019, 0.9, 3e4):
        picture = picture_lines(t, [Line("a", size * np.sin(t), BLUE)], "y", "c", 5.0)
        write_page(tmp_path / "p.html", "x", "y", [Section("s", pictures=[picture])])
        browser.show(tmp_path / "p.html")
        marks = browser.js("uPlot.sync('run').plots[0].axes[1]._values")
        assert len(set(marks)) == len(marks) >= 3, marks


def test_a_figure_shares_a_row_with_a_table_only_if_both_have_room(tmp_path: Path, browser: Browser) -> None:
    """A table of numbers that do not wrap ran under the figure next to it."""
    header = ["parameter", *["95 % interval"] * 4, "meaning"]
    table = Table(header, [["torque_offset_1", *["-0.123456 .. 0.123456"] * 4, "reflected inertia"]], range(1, 5))
    svg = '<svg viewBox="0 0 1 1"></svg>'
    write_page(tmp_path / "p.html", "x", "y", [Section("s", ["words"], [table], [Picture(svg, "c")])])
    for width in (1285, 1400, 1900):
        browser.show(tmp_path / "p.html", (width, 900))
        apart = browser.js("(t => (f => f.left >= t.right || f.top >= t.bottom)(document.querySelector('figure')"
                           ".getBoundingClientRect()))(document.querySelector('table').getBoundingClientRect())")
        assert apart and browser.js("document.documentElement.scrollWidth <= innerWidth")


def test_commands_break_at_spaces_alone_and_are_copied_as_typed(tmp_path: Path, browser: Browser) -> None:
    """On a phone, where `--model-out` met the end of a line, a browser broke it behind a hyphen."""
    files = " ".join(f"2026-11-23-left-leg-after-service-{k}.mcap" for k in range(3))
    command = f"legid fit {files} --rig 'my rig.toml' --model-out \"m^2 % `x`.json\" --html <page>.html --clear-faults"
    words = [f"{'x' * k} use --six-positions or legid monte-carlo --clear-faults --model-out" for k in range(12)]
    table = Table(["a", "b"], [["y", text] for text in words])
    write_page(tmp_path / "p.html", "x", words[3], [Section("s", words, [table], notes=words, command=command)])
    copied = ("(s => { s.selectAllChildren(document.querySelector('.command')); const text = s.toString(); "
              "s.removeAllRanges(); return text })(getSelection())")
    for size in (PHONE, (320, 700), LAPTOP):
        browser.show(tmp_path / "p.html", size)
        assert browser.js(copied) == command
        lines = browser.js("[...document.querySelectorAll('.whole')].map(e => [e.textContent, "
                           "e.getClientRects().length])")
        assert len(lines) == len(command.split(" ")) + 4 * 37 and {n for _, n in lines} == {1}
        assert {"--six-positions", "monte-carlo", "--model-out"} < {text for text, _ in lines}
        assert browser.sideways() <= 0
    browser.media("print")
    cut = browser.js("(c => c.scrollWidth - c.clientWidth)(document.querySelector('.command'))")
    browser.media("")
    assert cut <= 0


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
