"""`legid.investigation/1` as a struct: journals of earlier versions are read and shown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import legid

BELIEF: dict[str, Any] = {"verdict": "one_of", "sentence": "One of two causes.",
                          "causes": [{"effect": "quadratic_drag", "joint": 2}, {"effect": "gyro_scale", "joint": None}],
                          "error": {"before": 5.0, "after": 1.1},
                          "compared": [{"explanation": "quadratic_drag@2", "error": 1.1},
                                       {"explanation": "gyro_scale", "error": None}]}
RUN: dict[str, Any] = {"run": "run01.mcap", "kind": "first", "why": "Nothing is known.", "seconds": 10.0,
                       "peak_nm": 0.2, "ended": None, "expected": []}
SECOND = {**RUN, "run": "run02.mcap", "kind": "separate", "ended": "limit", "expected": [
    {"pair": "quadratic_drag@2 or gyro_scale", "log_likelihood_ratio": 7.5}]}
EARLIER: dict[str, Any] = {
    "schema": "legid.investigation/1", "ending": "failed", "why": "run02.mcap ended early.", "next_step": "Do it again",
    "answer": BELIEF, "diagnosed": ["run01.mcap"], "budget_s": 1800.0, "wall_s": 90.0,
    "steps": [{"before": None, "after": BELIEF, "wall_s": 60.0, "experiments": [RUN]},
              {"before": BELIEF, "after": None, "wall_s": 90.0, "experiments": [SECOND]}],
    "provenance": {"version": "0.1.0", "commit": "unknown", "runs": [], "rig": None, "model": None, "command": "",
                   "seed": None, "models": []}}


def test_a_journal_of_an_earlier_version_is_read_shown_and_written(tmp_path: Path) -> None:
    (tmp_path / "i.json").write_text(json.dumps(EARLIER))
    found = legid.Investigation.read(tmp_path / "i.json")
    lines = str(found).splitlines()
    assert lines[:2] == ["Nothing is known.", "  run01.mcap: first, 10 s, at most 0.2 N m"]
    assert lines[2] == ("  after 1.0 min: one_of (quadratic_drag@2, gyro_scale); held-out error in units of noise "
                        "alone: nominal model 5.00; quadratic_drag@2 1.10; gyro_scale inf")
    assert lines[4].endswith("expected log likelihood ratio quadratic_drag@2 or gyro_scale: 7.5; ended early: limit")
    assert lines[-2:] == ["run02.mcap ended early. 2 runs in 1.5 min.", "Next step: Do it again"]
    assert found.verdict == "one_of" and found.runs == ("run01.mcap", "run02.mcap")
    assert found.to_frame()["verdict"].dropna().tolist() == ["one_of"] and len(found.plot().axes) == 1
    assert repr(found) == "<Investigation: Nothing is known.>"
    found.page(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "Before: one_of" in page and "not diagnosed" in page and "Next step: Do it again" in page
    found.to_json(tmp_path / "again.json")
    again = json.loads((tmp_path / "again.json").read_text())
    beliefs = [again["answer"], again["steps"][0]["after"], again["steps"][1]["before"]]
    assert [one.pop("warnings") for one in beliefs] == [[], [], []] and again == EARLIER


def test_without_a_diagnosis_there_is_nothing_to_draw(tmp_path: Path) -> None:
    (tmp_path / "i.json").write_text(json.dumps({**EARLIER, "answer": None, "steps": EARLIER["steps"][1:]}))
    found = legid.Investigation.read(tmp_path / "i.json")
    assert found.verdict is None and "No diagnosis." in str(found)
    with pytest.raises(legid.WorkError, match="ended early"):
        found.plot()
