"""A diagnosis as JSON, text and page: complete, in the order promised, honest where there is nothing to show."""

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from estimator import Diagnosis, Verdict
from estimator.diagnosis import HorizonGain, Remainder, SensorGain
from estimator.model import leg2
from experiments.documents import DiagnosisDocument
from experiments.reports import (
    Picture,
    Section,
    axis_label,
    diagnosis_sections,
    diagnosis_text,
    key_label,
    signature_limits,
    write_diagnosis,
)
from experiments.reports.html import render_page, typeset
from tests.support.diagnoses import synthetic
from tests.support.pages import Outside, allowed_script
from tests.support.shell import read_json

CONTRACT = Path(__file__).parent / "diagnosis.json"
"""Where it gives a rotor no joint, the library does; what is tested at the knee is testable."""


@pytest.fixture(scope="module")
def page() -> str:
    return page_of(replace(synthetic(), mechanism=leg2(lever_arm=0.2)))


def text_of(found: Diagnosis) -> str:
    return diagnosis_text(DiagnosisDocument.of(found))


def sections_of(found: Diagnosis) -> list[Section]:
    return diagnosis_sections(DiagnosisDocument.of(found), found)


def pictures_of(found: Diagnosis) -> list[Picture]:
    return [picture for section in sections_of(found) for picture in section.pictures]


def page_of(found: Diagnosis) -> str:
    return render_page("t", "", sections_of(found), verdict=DiagnosisDocument.of(found).headline)


def test_document_is_the_contract() -> None:
    assert DiagnosisDocument.of(synthetic()).document == read_json(CONTRACT)


def test_the_gain_is_stated_by_horizon() -> None:
    found = replace(synthetic(), by_horizon=(HorizonGain(0.1, 0.5, (0.4, 0.62)), HorizonGain(np.inf, 1.2, (0.9, 1.5))))
    assert DiagnosisDocument.of(found).document["gain"]["by_horizon"] == [
        {"horizon_s": 0.1, "ratio": 0.5, "ci95": [0.4, 0.62]}, {"horizon_s": None, "ratio": 1.2, "ci95": [0.9, 1.5]}]
    told = "over that of the nominal one: 0.5 [0.4, 0.62] over 0.1 s, 1.2 [0.9, 1.5] over whole runs."
    assert told in text_of(found) and told in page_of(found) and "nominal one:" not in text_of(synthetic())


@pytest.mark.parametrize(("probability", "told"), [(0.874, "0.87"), (1.0, "above 0.99"), (None, "")])
def test_an_answer_states_its_probability_and_the_condition(probability: float | None, told: str) -> None:
    found = replace(synthetic(), probability=None if probability is None else 0.856, in_library=probability)
    document = DiagnosisDocument.of(found).document
    assert (document["probability"], document["probability_in_library"]) == (found.probability, probability)
    line = f"Probability of this answer: 0.86, as on simulated legs; {told} if the library has the true causes."
    for text in (text_of(found), " ".join(DiagnosisDocument.of(found).headline.lines)):
        assert (line in text) is bool(told) and ("Probability" in text) is bool(told)


def test_page_answers_in_the_order_of_the_questions(page: str) -> None:
    titles = re.findall(r"<h2>(.*?)</h2>", page)
    assert titles == ["Causes", "The mechanism", "What the error consists of", "How far the simulation is off",
                      "Candidates", "Signature",
                      "Simulation against measurement, before and after", "What can be told apart",
                      "What the extension does to the parameters", "Next experiment", "Ruled out",
                      "What cannot be tested here", "Runs"]
    assert page.index(synthetic().sentence.replace("'", "&#39;")) < page.index("<h2>")


def test_a_cause_that_is_named_is_not_ruled_out_by_its_own_score() -> None:
    """Alone it can explain nothing, and a good deal next to another."""
    cause, *_ = synthetic().causes
    scores = tuple(replace(c, p_value=0.5) for c in synthetic().candidates)
    sections = sections_of(replace(synthetic(), candidates=scores))
    rows = {section.title: str(section) for section in sections}["Ruled out"]
    others = [c.effect for c in scores if (c.effect, c.joint) != (cause.effect, cause.joint)]
    assert others and cause.effect not in rows and all(name in rows for name in others)


def test_page_begins_with_one_sentence_one_figure_and_one_action(page: str) -> None:
    head, rest = page[page.index("<body>"):].split("</header>")
    assert head.count("<svg") == 1 and axis_label("q2_rad") in head  # the joint of the cause
    assert head.index("excess torque 0.05 N m") < head.index("Next step: Validate the extended model")
    assert rest.count("<h2>") == rest.count("<details>") == 13


def test_errors_lead_where_no_run_is_drawn() -> None:
    page = page_of(replace(synthetic(), traces=()))
    assert "multiples of what noise alone leaves" in page.split("</header>")[0]


def test_page_shows_what_was_found(page: str) -> None:
    for words in ("0.04 .. 0.06", "few runs", "closes 81 %", "67 to 93 %", "p = 0.004",
                  '&lt; <span class="whole">1e-6</span>',
                  "presliding_friction, joint 2", "backlash, joint 1", "Slow reversals.", "noise alone", "0.006"):
        assert typeset(words) in page, words
    assert page.count("<svg") == 1 + 1 + 1 + 2 + 2 + 1 + 1


def test_page_is_one_file_and_its_figures_are_drawn(page: str) -> None:
    parser = Outside()
    parser.feed(page)
    assert parser.found == [] and parser.scripts == 1
    allowed_script(page)
    figures = re.findall(r"<svg.*?</svg>", page, re.DOTALL)
    for svg in figures:
        root = ElementTree.fromstring(svg)
        assert "viewBox" in root.attrib and "width" not in root.attrib and "<image" not in svg
        assert "#010203" not in svg and len(svg) < 200_000
    clips = [i for svg in figures for i in re.findall(r'<clipPath id="([^"]*)"', svg)]
    assert len(clips) == len(set(clips))  # one page: a figure must not be cut by another's frame


def test_signatures_of_rivals_share_their_axes() -> None:
    found = synthetic().signatures
    ((key, (x, y)),) = signature_limits(found).items()
    assert key == ("velocity of joint 2 [rad/s]", "torque of joint 2 [N m]") and x == (-2.0, 2.0)
    assert y[0] == min(float((s.before - s.before_error).min()) for s in found)
    assert y[1] == max(float((s.before + s.before_error).max()) for s in found)


def test_text_begins_with_the_verdict_and_what_next() -> None:
    text = text_of(synthetic())
    assert text.startswith(synthetic().sentence)
    assert "The error falls in 2 of 3 rotations." in text and "on all runs, each held out once" in text
    order = ["Warning: few runs", "Next step: ", "every run was held out once",
             "stribeck_friction, joint 2: excess_torque  0.0471", "Causes:",
             "0.04 .. 0.06", "Free-run error", "Next best effects", "Cannot be tested",
             "Next experiment: Slow reversals.", "Runs: fit r1.csv, r3.csv"]
    assert [text.index(words) for words in order] == sorted(text.index(words) for words in order)
    runners = text[text.index("Next best effects"):text.index("Cannot")]
    assert "stribeck" not in runners and "presliding_friction, joint 2" in runners


def test_a_nominal_simulation_that_diverges_has_no_number() -> None:
    whole = synthetic()
    found = replace(whole, sensors={**whole.sensors, "q2_rad": SensorGain(np.inf, 0.02, 0.015)})
    assert DiagnosisDocument.of(found).document["gain"]["free_run_rmse"]["q2_rad"] == {"before": None, "after": 0.02,
                                                                           "floor": 0.015}
    text = text_of(found)
    assert "diverged" in text and "extension closes 90 % of the gap in mean square" in text
    page = page_of(found)
    assert "diverged" in page and "inf" not in re.findall(r"<td[^>]*>([^<]*)</td>", page)


@pytest.mark.parametrize("verdict", ["none", "one_of", "unexplained", "fit_failed"])
def test_verdicts_with_less_to_show(verdict: Verdict) -> None:
    whole = synthetic()
    bare = Diagnosis(verdict, "No more than this.")
    for found in (bare, replace(whole, verdict=verdict, causes=(), sensors={}, signatures=(), traces=(), extended={},
                                extended_std={}, gap_closed=None, gap_closed_ci95=None)):
        page = page_of(found)
        assert "No more than this." in page or whole.sentence in page
        assert "The extension closes" not in page and "nan<" not in page and ">None<" not in page
        document = DiagnosisDocument.of(found).document
        assert document["verdict"] == verdict and document["gain"]["gap_closed"] is None and document["causes"] == []
        assert text_of(found).startswith(found.sentence)


def test_sensors_have_units_and_joints_are_those_of_the_contract() -> None:
    assert [axis_label(c) for c in ("q2_rad", "gyro_radps", "accel_x_mps2")] == ["q2 [rad]", "gyro [rad/s]",
                                                                                 "accel_x [m/s²]"]
    keys = {"rotor_inertia@2": "rotor_inertia", "q2 in gyro": "q2 in gyro", "backlash@2": "backlash, joint 2",
            "|q| sign v@2": "|q| sign v, joint 2"}
    assert [key_label(key) for key in keys] == list(keys.values())


def with_two_rotors() -> Diagnosis:
    whole = synthetic()
    rotor = next(c for c in whole.candidates if c.effect == "rotor_inertia")
    return replace(whole, candidates=(*whole.candidates, replace(rotor, joint=1)))


def test_no_column_is_empty_and_no_two_candidates_are_called_alike() -> None:
    """Two motors have two rotors, though a contract counts them as one effect; a fit that does not settle has no
    intervals."""
    whole = with_two_rotors()
    found = replace(whole, extended={}, extended_std={}, nominal_std=dict.fromkeys(whole.nominal, float("inf")))
    sections = {s.title: s for s in sections_of(replace(found, mechanism=leg2(lever_arm=0.2)))}
    named = [row[0] for row in sections["Candidates"].tables[0].rows]
    assert len(set(named)) == len(named) and "rotor_inertia, joint 1" in named
    (table,) = sections["Parameters"].tables
    assert list(table.header) == ["parameter", "nominal", "unit", "meaning"] and len(table.rows[0]) == 4


def test_the_lead_figure_shows_the_joint_of_the_cause() -> None:
    """It showed the joint of the largest error, the pivot of a leg whose knee has the cause."""
    found = synthetic()
    for joint in (1, 2):
        moved = replace(found, causes=(replace(found.causes[0], joint=joint),))
        (lead,) = (p for p in pictures_of(moved) if p.leads)
        assert lead.caption.startswith(f"q{joint}_rad in run")
    unnamed = replace(found, causes=(), remainder=Remainder(1, "torque1", "q v"))
    (lead,) = (p for p in pictures_of(unnamed) if p.leads)
    assert lead.caption.startswith("q1_rad")


def test_a_caption_says_what_paper_shows_and_a_flat_signature_is_no_picture() -> None:
    found = synthetic()
    trace = found.traces[0]
    long = replace(trace, time_s=np.linspace(0.0, 20.0, trace.time_s.size))
    pictures = pictures_of(replace(found, traces=(long,)))
    assert {p.still for p in pictures if p.chart} == {"The first 12 of 20 s."}
    assert not any("12 " in p.caption for p in pictures)
    flat = replace(found.signatures[0], before=0.01 * found.signatures[0].curve)
    section = next(s for s in sections_of(replace(found, signatures=(flat, found.signatures[1])))
                   if s.title == "Signature")
    assert len(section.pictures) == 1 and "absorb it" in section.notes[0]


def test_the_text_has_the_corrected_parameters() -> None:
    text = text_of(synthetic())
    assert "These shifts are their bias." in text and "corrected" in text
    assert re.search(r"beta1 +0\.1000 +\S+ \.\. \S+ +0\.1100", text)


def test_text_and_page_of_a_file_are_those_of_the_result_without_its_curves(tmp_path: Path) -> None:
    found = replace(synthetic(), mechanism=leg2(lever_arm=0.2), hold="linear")
    made = DiagnosisDocument.of(found, model="leg2")
    made.to_json(tmp_path / "d.json")
    read = DiagnosisDocument.read(tmp_path / "d.json")
    assert diagnosis_text(read) == diagnosis_text(made)
    for name, kept in (("kept", found), ("read", None)):
        write_diagnosis(tmp_path / f"{name}.html", read, kept)
    whole, page = ((tmp_path / f"{name}.html").read_text() for name in ("kept", "read"))
    assert "<h1>Diagnosis of leg2: cause named</h1>" in page and "multiples of what noise alone" in page
    titles = [re.findall(r"<h2>(.*?)</h2>", one) for one in (whole, page)]
    assert [t for t in titles[0] if t not in titles[1]] == [
        "The mechanism", "Signature", "Simulation against measurement, before and after", "What can be told apart"]
    assert all(f"<td data-label=\"{name}\"" in page for name in ("share", "corrected", "smallest detectable"))


def test_two_rotors_are_told_apart_in_the_document() -> None:
    found = DiagnosisDocument.of(with_two_rotors()).document
    assert [(c["joint"], c.get("motor")) for c in found["candidates"][2:]] == [(None, 2), (None, None), (None, 1)]
