"""`legid.diagnosis/1` as a struct: files of earlier versions are read and told, and what only a diagnosis has is
refused."""

from __future__ import annotations

import json
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import pytest

import legid
from estimator.diagnosis import Diagnosis as Details
from experiments.documents import DiagnosisDocument
from tests.support.diagnoses import synthetic

FIRST: dict[str, Any] = {
    "schema": "legid.diagnosis/1", "verdict": "named", "sentence": "A spring acts at joint 2.",
    "causes": [{"effect": "joint_stiffness", "joint": 2, "meaning": "a spring", "p_value": 1e-9,
                "size": [{"name": "stiffness", "unit": "N m/rad", "value": 0.45, "ci95": [0.446, 0.454]}],
                "confusable_with": ["torque_ripple"]}],
    "candidates": [{"effect": "torque_offset", "joint": None, "score": 24.1, "p_value": 1e-7, "size": -0.04,
                    "smallest_detectable": None, "unit": "N m"}],
    "gain": {"confirm_runs": ["run4.mcap"],
             "free_run_rmse": {"q1_rad": {"before": None, "after": 0.01, "floor": 0.009},
                               "q2_rad": {"before": 0.056, "after": 0.0045, "floor": 0.0025}},
             "torque_rms_nm": {"before": [0.01, 0.05], "after": [0.01, 0.02]},
             "gap_closed": 0.99, "gap_closed_ci95": [0.98, 1.0]},
    "parameters": {"nominal": {"beta1": 0.157}, "extended": {"beta1": 0.113}},
    "not_testable": [{"effect": "torque_gain", "joint": None, "why": "it scales all"}],
    "runs": {"fit": ["run1.mcap"], "screen": ["run2.mcap"], "confirm": ["run4.mcap"]}, "warnings": ["few runs"],
    "next_experiment": "", "wall_s": 20.0}
"""As an early version wrote it."""


@pytest.fixture
def early(tmp_path: Path) -> Path:
    path = tmp_path / "early.json"
    path.write_text(json.dumps(FIRST))
    return path


def test_an_early_version_is_read_and_told(early: Path) -> None:
    found = legid.Diagnosis.read(early)
    assert found.verdict == "named" and found.causes[0].size[0].ci95 == (0.446, 0.454)
    assert found.sensors["q1_rad"].before == inf and found.sensors["q2_rad"].after == 0.0045
    assert found.confirm_runs == ("run4.mcap",) and found.gap_closed == 0.99 and found.material == 0.1
    text = str(found)
    assert text.startswith("A spring acts at joint 2.\n") and "joint_stiffness, joint 2" in text
    assert "diverged" in text and "held-out runs run4.mcap" in text
    assert list(found.to_frame()["value"]) == [0.45]
    assert list(found.to_frame("candidates")["smallest_detectable"]) == [inf]
    assert "With errors of at most the sensor" in found._repr_html_() and "Warning: few runs" in found._repr_html_()


def test_what_was_read_is_written_as_it_was(early: Path) -> None:
    again = legid.Diagnosis.read(early).document
    names = set(FIRST) - {"parameters"}
    assert {key: again[key] for key in names} == {key: FIRST[key] for key in names}
    assert again["parameters"] == {**FIRST["parameters"], "nominal_std": {}, "extended_std": {}}


def test_a_file_has_no_models_and_no_curves(early: Path, tmp_path: Path) -> None:
    found = legid.Diagnosis.read(early)
    assert found.text().startswith(found.sentence)
    found.page(tmp_path / "p.html")
    assert "Diagnosis: cause named" in (tmp_path / "p.html").read_text()
    for ask in (found.plot, lambda: legid.model(found)):
        with pytest.raises(legid.WorkError, match="read from a file, which has no models and no curves"):
            ask()


def test_a_document_is_read_as_it_was_made(tmp_path: Path) -> None:
    for one in (synthetic(), replace(synthetic(), verdict="one_of"), Details("fit_failed", "too short")):
        made = DiagnosisDocument.of(one)
        made.to_json(tmp_path / "d.json")
        assert DiagnosisDocument.read(tmp_path / "d.json") == made
