"""`legid.diagnosis/1` as a struct: files of earlier versions are read and told, and what only a diagnosis has is
refused."""

from dataclasses import replace
from math import inf
from pathlib import Path

import pytest

import legid
from estimator import Diagnosis as Details
from experiments.documents import DiagnosisDocument, finite
from tests.support.diagnoses import synthetic
from tests.support.earlier import FOLDER, earlier, written_by

FIRST, EARLY = earlier("diagnosis"), FOLDER / "diagnosis.json"
"""As an early version wrote it."""


def test_an_early_version_is_read_and_told() -> None:
    found = legid.Diagnosis.read(EARLY)
    assert found.verdict == "named" and found.causes[0].size[0].ci95 == (0.446, 0.454)
    assert found.sensors["q1_rad"].before == inf and found.sensors["q2_rad"].after == 0.0045
    assert found.confirm_runs == ("run4.mcap",) and found.gap_closed == 0.99 and found.material == 0.1
    text = str(found)
    assert text.startswith("A spring acts at joint 2.\n") and "joint_stiffness, joint 2" in text
    assert "diverged" in text and "held-out runs run4.mcap" in text
    assert list(found.to_frame()["value"]) == [0.45]
    assert list(found.to_frame("candidates")["smallest_detectable"]) == [inf]
    assert "Warning: few runs" in found._repr_html_() and "held-out runs run4.mcap" in found._repr_html_()


def test_what_was_read_is_written_as_it_was() -> None:
    again = legid.Diagnosis.read(EARLY).document
    names = set(FIRST) - {"parameters"}
    assert {key: again[key] for key in names} == {key: FIRST[key] for key in names}
    assert again["parameters"] == {**FIRST["parameters"], **{
        f"{model}_{what}": {} for model in ("nominal", "extended") for what in ("std", "ci95")}}


def test_a_file_has_no_models_and_no_curves() -> None:
    found = legid.Diagnosis.read(EARLY)
    assert found.text().startswith(found.sentence)
    assert "Diagnosis: cause named" in written_by(found.page)
    for ask in (found.plot, lambda: legid.model(found)):
        with pytest.raises(legid.WorkError, match="read from a file, which has no models and no curves"):
            ask()


def test_a_document_is_read_as_it_was_made(tmp_path: Path) -> None:
    for one in (synthetic(), replace(synthetic(), verdict="one_of"), Details("fit_failed", "too short")):
        made = DiagnosisDocument.of(one)
        made.to_json(tmp_path / "d.json")
        assert DiagnosisDocument.read(tmp_path / "d.json") == made
        given = made.parameters
        for values, std, ci95 in ((given.nominal, given.nominal_std, given.nominal_ci95),
                                  (given.extended, given.extended_std, given.extended_ci95)):
            assert ci95 == {name: pytest.approx((finite(values[name]) - 1.96 * finite(std[name]),
                                                 finite(values[name]) + 1.96 * finite(std[name])), rel=1e-3, abs=1e-6)
                            for name in std}
