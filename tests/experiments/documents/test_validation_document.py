"""`legid.validation/1` as a struct: files of earlier versions are read, and its keys are told."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import legid
from experiments.documents import DOCUMENTED, Document, ValidationDocument, keys_table
from experiments.documents.document import described
from experiments.reports import whole_validation_text

EARLIER: dict[str, Any] = {
    "schema": "legid.validation/1", "sensors": "imu",
    "fit_percent": [{"run": "a.csv", "whole": {"q1_rad": None, "q2_rad": 91.0},
                     "short": {"q1_rad": 95.0, "q2_rad": 97.0}, "short_s": 1.0}],
    "runs": [{"run": "a.csv", "samples": 900, "horizon_s": 3.1, "diverged": True,
              "initial_state": {"q1_rad": 0.1, "q1d": 0.2, "q2_rad": 0.3, "q2d": 0.4},
              "summed_squared_error": {"q1_rad": None, "q1d": None, "q2_rad": 4.0, "q2d": 5.0},
              "rmse": {"q1_rad": 0.01, "q1d": 0.02, "q2_rad": 0.03, "q2d": 0.04}}],
    "trust": {"level": "caution", "sentence": "ROUGH: over 1 s it is.", "reasons": ["Look at it."]},
    "fitted_to": [],
    "horizons": [{"horizon_s": 0.5, "pieces": 18, "blown_up": 2, "rmse": {"q1_rad": 0.3, "q2_rad": None},
                  "last_velocity": {"q1_rad": 0.2, "q2_rad": 0.2}, "noise": {"q1_rad": 0.001, "q2_rad": 0.001}},
                 {"horizon_s": 9.0, "pieces": 1, "blown_up": 1, "rmse": {"q1_rad": None, "q2_rad": 0.03},
                  "last_velocity": {"q1_rad": 2.0, "q2_rad": 2.0}, "noise": {"q1_rad": 0.001, "q2_rad": 0.001}}],
    "set_aside": [{"run": "b.csv", "why": "it stands still"}], "readings": [], "damaged": [],
    "provenance": {"version": "0.1.0", "commit": "unknown", "runs": [{"file": "a.csv", "sha256": "0" * 64}],
                   "rig": None, "model": None, "command": "legid validate", "seed": None, "models": []}}
"""As version 0.1 wrote it: no `start_s`, no `band95`."""


@pytest.fixture
def earlier(tmp_path: Path) -> Path:
    path = tmp_path / "earlier.json"
    path.write_text(json.dumps(EARLIER))
    return path


def test_a_document_of_an_earlier_version_is_read_and_told(earlier: Path) -> None:
    found = legid.Validations.read(earlier)
    text = whole_validation_text(found)
    assert text.startswith("ROUGH: over 1 s it is.\nLook at it.\n") and "a.csv: the simulation diverged" in text
    assert "at 0.5 s 2 of 18 simulations of the model diverged" in text
    assert text.count("diverged") == 4 and " diverged " in text.split("fit, whole run")[1]
    assert "at 0.5 s a constant velocity predicts a joint better than the model" in text
    assert str(found).splitlines()[0] == "ROUGH: over 1 s it is."
    assert repr(found) == "<Validations: ROUGH: over 1 s it is.>"
    assert found.set_aside[0].run == "b.csv" and len(found) == 1
    assert found.to_frame().loc["a.csv", "q2_rad"] == 0.03 and "<table>" in found._repr_html_()
    found.page(earlier.parent / "p.html")
    assert "Look at it." in (earlier.parent / "p.html").read_text()
    for ask in (found.plot, lambda: found[0]):
        with pytest.raises(legid.WorkError, match="read from a file, which has no motion"):
            ask()


def test_what_was_read_is_written_as_it_was(earlier: Path, tmp_path: Path) -> None:
    legid.Validations.read(earlier).to_json(tmp_path / "again.json")
    again = json.loads((tmp_path / "again.json").read_text())
    for part, more in ((again["fit_percent"][0], ("band95", {})), (again["runs"][0], ("start_s", None))):
        assert part.pop(more[0]) == more[1]
    again["provenance"]["runs"][0].pop("inside")
    assert again == EARLIER and list(again) == list(EARLIER)


def test_another_file_is_refused(tmp_path: Path) -> None:
    for text, told in (('{"schema": "legid.fit/1"}', "legid.fit/1"), ("[1, 2", "is no such document")):
        (tmp_path / "f.json").write_text(text)
        with pytest.raises(legid.InputError, match=told):
            ValidationDocument.read(tmp_path / "f.json")


@pytest.mark.parametrize("kind", DOCUMENTED.values())
def test_every_key_is_told(kind: type[Document]) -> None:
    rows = list(described(kind))
    assert [key for key, _, _ in rows] == list(kind.__struct_encode_fields__) and all(meaning for _, meaning, _ in rows)
    table = keys_table(kind)
    assert f"| `{rows[1][0]}` | {rows[1][1]} |" in table and "|  |" not in table
