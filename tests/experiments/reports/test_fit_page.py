"""The report page: complete, self-contained, escaped, and readable at a phone's width as far as text can tell."""

import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from estimator import Combination, Finding, FitResult, RunAgreement
from estimator.model import Mechanism, joint1
from experiments.emulation import LegBody
from experiments.judge import Headline, estimates_of, number
from experiments.reports import (
    BLUE,
    Line,
    Picture,
    Section,
    Table,
    fit_summary,
    fit_text,
    picture_lines,
    plot_lines,
    truth_section,
    window,
)
from experiments.reports.html import fold, render_page, typeset
from tests.support.fits import document_of, page_of, sections_of, synthetic_fit, text_of
from tests.support.pages import Outside, allowed_script


@pytest.fixture(scope="module")
def page() -> str:
    result = synthetic_fit()
    return render_page("Leg <A> & co", fit_summary(document_of(result)),
                       [*sections_of(result), truth_section(result.mechanism, estimates_of(result), true_values())])


def true_values() -> dict[str, float]:
    """Parameters of the plant by name."""
    return dict(zip(synthetic_fit().mechanism.names, LegBody().beta()))


def test_page_fetches_nothing_and_runs_its_own_script_alone(page: str) -> None:
    parser = Outside()
    parser.feed(page)
    assert parser.found == [] and parser.scripts == 1
    script = allowed_script(page)
    assert not re.search(r"url\((?!#)", page.replace(script, "")) and "@import" not in page
    reaching = r"\b(fetch|XMLHttpRequest|WebSocket|EventSource|sendBeacon|importScripts|eval)\b|\bimport\("
    assert not re.search(reaching, script)


def test_curves_go_into_the_page_whole_and_cannot_end_their_element() -> None:
    t = np.arange(3000) / 100.0
    values = np.sin(t)
    values[7] = np.nan
    picture = picture_lines(t, [Line("</script><b>", values, BLUE)], "y [m]", "c", 5.0)
    page = render_page("x", "y", [Section("s", pictures=[picture])])
    (data,) = re.findall(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)
    chart = json.loads(data)
    assert [line["label"] for line in chart["lines"]] == ["</script><b>"]
    assert chart["lines"][0]["values"][7] is None and len(chart["time"]) == 3000
    np.testing.assert_allclose(chart["lines"][0]["values"][8:], values[8:], rtol=6e-5)
    assert "<b>" not in page and page.count("</script>") == 2
    allowed_script(page)


def test_contents_lead_to_every_section_and_the_verdict_stands_first() -> None:
    sections = [Section(title, ["words"]) for title in ("A & b", "C", "C")]
    page = render_page("t", "summary", sections, verdict=Headline("bad", "NOT TO BE USED", ["why"], ["<w>"]))
    links = re.findall(r'<a href="#([^"]+)">', page)
    assert links == re.findall(r'<div class="body" id="([^"]+)">', page) and len(set(links)) == 3
    page = page[page.index("<body>"):]
    order = ["<h1>", 'data-tone="bad"', "NOT TO BE USED", "why", "Warning: &lt;w&gt;", "summary", "<nav", "<h2>"]
    assert [page.index(text) for text in order] == sorted(page.index(text) for text in order)


def test_a_figure_that_leads_stands_at_the_head_and_nowhere_else() -> None:
    svg = '<svg viewBox="0 0 1 1"><title>{}</title></svg>'
    pictures = [Picture(svg.format(name), name, leads=name != "last") for name in ("first", "second", "last")]
    page = render_page("t", "", [Section("A", ["of the first alone"], pictures=pictures[:1]),
                                 Section("B", pictures=pictures[1:])])
    head, rest = page.split("</header>")
    assert "<title>first</title>" in head and "<title>first</title>" not in rest and "of the first alone" not in rest
    assert "<title>second</title>" in rest and "<title>last</title>" in rest


def test_folded_sections_show_their_headings_and_need_no_contents() -> None:
    page = render_page("t", "", [Section("Open", ["seen"]), *fold(*(Section(name, ["hidden"]) for name in "ABC")),
                                 *fold(Section("Empty"), None)])
    body = page[page.index("<body>"):]
    assert re.findall(r"<details><summary><h2>(.*?)</h2></summary>", body) == ["A", "B", "C"]
    assert "<nav" not in body and "<h2>Open</h2>" in body and "Empty" not in body


def test_text_from_files_is_escaped() -> None:
    hostile, svg = "<script>alert(1)</script>", '<svg viewBox="0 0 1 1"></svg>'
    page = render_page(hostile, hostile, [Section(hostile, [hostile], [Table([hostile], [[hostile]], (), hostile)],
                                                  [Picture(svg, hostile)], notes=[hostile])])
    assert "<script" not in page and page.count("&lt;script&gt;") == 10 and svg in page


def test_hostile_name_in_a_figure_stays_text() -> None:
    svg = plot_lines(np.arange(3.0), [Line("<script>x</script>", np.arange(3.0), BLUE)], "y [m]")
    assert "<script" not in svg
    ElementTree.fromstring(svg)


def test_every_parameter_stands_with_interval_and_unit(page: str) -> None:
    result = synthetic_fit()
    for p, (low, high), std in zip(result.mechanism.parameters, result.ci95(), result.std):
        assert p.name in page and typeset(p.meaning) in page and typeset(p.unit) in page
        assert f"{number(low, std)} .. {number(high, std)}" in page


def test_figures_of_the_paper_are_there_with_units(page: str) -> None:
    for label in ("gyro [rad/s]", "accelerometer x [m/s²]", "accelerometer y [m/s²]", "torque, joint 1 [N m]",
                  "torque, joint 2 [N m]"):
        assert label in page
    pictures = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert pictures.count("time [s]") == 5
    assert page.count(">zero<") == 1  # the pivot's line only
    for svg in re.findall(r"<svg.*?</svg>", page, re.DOTALL):
        root = ElementTree.fromstring(svg)
        assert "viewBox" in root.attrib and "width" not in root.attrib  # scales with the column
        assert len(svg) < 200_000


def test_an_angle_keeps_its_symbol_in_a_caption() -> None:
    path = synthetic_fit().trajectories[0]
    angles = {"q1_rad": path.q[:, 0], "q2_rad": path.q[:, 1]}
    fit = replace(synthetic_fit(), sensors="encoder", trajectories=(replace(path, measured=angles, predicted=angles),))
    captions = [picture.caption for section in sections_of(fit) for picture in section.pictures]
    assert [text[:18] for text in captions if "as estimated" in text] == ["Angle q1, measured", "Angle q2, measured"]


def test_figures_follow_the_colour_scheme(page: str) -> None:
    assert "currentColor" in page and "prefers-color-scheme: dark" in page
    assert "#010203" not in page and "#000000" not in page


def test_unconverged_and_undetermined_fits_say_so() -> None:
    result = replace(synthetic_fit(), converged=False,
                     undetermined=(Combination((("beta8", 1.0), ("beta6", -0.5))),), trajectories=(),
                     findings=(Finding("warning", "run_note", "few samples"),))
    result.covariance[7, 7] = np.inf
    assert "beta8 -0.5*beta6" in page_of(result)
    told = document_of(result).headline.told
    assert told[:2] == ["NOT TO BE USED: the fit did not converge.", "Warning: few samples"]
    text = text_of(result)
    assert "not determined by this data: beta8" in text
    assert result.open_parameters == {"beta6", "beta8"}
    assert "nan" not in text.lower() and "inf" not in text.lower().replace("infinite", "")


def test_a_truth_outside_its_interval_is_counted_as_such() -> None:
    result, truth = synthetic_fit(), true_values()
    truth["beta1"] *= 1.2
    section = truth_section(result.mechanism, estimates_of(result), truth)
    assert "8 of 9" in section.paragraphs[0] and section.tables[0].rows[0][4] == "no"


def test_intervals_against_the_truth_are_those_of_the_fit() -> None:
    """As wide as what runs disagree about makes them, and from zero upwards where a level is held there."""
    result, k = synthetic_fit(), 0
    names, std = result.mechanism.names, result.std
    truth = dict(zip(names, map(float, result.beta))) | {names[k]: float(result.beta[k] + 3.0 * std[k])}
    agreement = RunAgreement(("a", "b"), 1e-4, std / 2.0, True, np.full(std.size, 4.0))
    narrow, wide = (truth_section(result.mechanism, estimates_of(one), truth).tables[0].rows
                    for one in (result, replace(result, agreement=agreement, at_bound={names[7]: 0.5})))
    assert [row[4] for row in (narrow[k], wide[k])] == ["no", "yes"]
    low, high = (float(text) for text in wide[k][3].split(" .. "))
    assert high - low == pytest.approx(8.0 * std[k], rel=0.05)
    assert [float(text) for text in wide[7][3].split(" .. ")] == [0.0, 0.5]


def test_units_follow_the_joint_and_its_input() -> None:
    def text(mechanism: Mechanism) -> str:
        p = mechanism.p
        result = FitResult(mechanism, "wls", "encoder", np.ones(p), np.eye(p), {"torque_nm": 0.1, "encoder_rad": 0.2},
                           np.array([0.1]), True, 1, 100, 0.0)
        document = document_of(result, "joint1")
        return fit_text(document) + fit_summary(document)

    slide, servo = text(joint1(prismatic=True, gravity_mps2=0.0)), text(joint1(voltage=True))
    assert "torque 0.1 N," in slide and "encoder 0.2 m" in slide and "volt" not in slide
    assert "torque 0.1 V," in servo and "encoder 0.2 rad" in servo and servo.count("every parameter is in volt") == 2


def test_numbers_carry_the_digits_that_mean_something() -> None:
    assert number(0.123456, 0.0012) == "0.1235"
    assert number(12.3456, 1.2) == "12.3"
    assert number(1234.5, 200.0) == "1234"
    assert number(0.5) == "0.5"
    assert number(float("nan"), 1.0) == "not determined"


def at_rest_first(ringing: float) -> FitResult:
    """A fit of a leg that rests for two seconds, in which the model's torque of both joints rings."""
    result = synthetic_fit()
    path, rest = result.trajectories[0], slice(0, 200)
    qd, tau = path.qd.copy(), path.tau.copy()
    qd[rest] = 0.0
    tau[rest] += ringing * np.array([1.0, -1.0])[np.arange(200) % 2][:, None]
    tau[:, 0] *= np.where(np.arange(len(tau)) < 200, 1.0, 0.1)
    return replace(result, trajectories=(replace(path, qd=qd, tau=tau),), noise={**result.noise, "torque_nm": 0.02,
                                                                                 "passive_joint_nm": 0.002})


def test_what_rings_at_rest_is_not_drawn() -> None:
    """Dry friction may hold a resting joint against anything, so the model's torque is not known there."""
    result = at_rest_first(5.0)
    (section,) = [s for s in sections_of(result) if s.title == "Torques"]
    for picture in section.pictures:
        known = next(line.values for line in picture.chart.lines if line.label == "model (mle)")
        assert np.isnan(known[:200]).all() and np.nanmax(np.abs(known)) < 2.0
        assert "where dry friction says what it is" in picture.caption and "is not known" in picture.caption


def test_window_takes_the_beginning() -> None:
    t = np.arange(100) / 10.0 + 5.0
    assert window(t, 2.0) == slice(0, 21)
    assert window(t, 1e9) == slice(0, 100)


def test_a_gap_leaves_a_hole_in_the_curve() -> None:
    values, moves = np.sin(np.arange(50.0)), []
    for hole in (slice(0), slice(20, 25)):
        values[hole] = np.nan
        svg = plot_lines(np.arange(50.0), [Line("a", values, BLUE)], "y [m]")
        moves.append(max(re.findall(r' d="([^"]*)"', svg), key=len).count("M "))
    assert moves == [1, 2]
