"""`legid.comparison/1` as a struct: files of earlier versions are read and shown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import legid

EARLIER: dict[str, Any] = {
    "schema": "legid.comparison/1", "models": ["a.json", "b.json"], "runs": ["r.csv"],
    "parameters": [{"name": "beta1", "unit": "kg m^2", "meaning": "inertia", "a": {"value": 0.1, "std": None,
                    "ci95": [None, None]}, "b": {"value": 0.12, "std": 0.01, "ci95": [0.1, 0.14]}, "z": None},
                   {"name": "backlash@2 gap", "unit": "rad", "meaning": "play", "a": None,
                    "b": {"value": 0.02, "std": 0.001, "ci95": [0.018, 0.022]}, "z": None}],
    "errors": [{"horizon_s": 0.5, "column": "q1_rad", "a": 0.2, "b": 0.1, "ratio": 0.5, "ratio_ci95": [0.4, 0.6],
                "better": "B"},
               {"horizon_s": None, "column": "q1_rad", "a": None, "b": 0.3, "ratio": None, "ratio_ci95": None,
                "better": "B"}],
    "trust": {"level": "good", "sentence": "B IS BETTER (b.json): at 2 of 2.", "reasons": []},
    "set_aside": [], "damaged": [],
    "provenance": {"version": "0.1.0", "commit": "unknown", "runs": [], "rig": None, "model": None, "command": "",
                   "seed": None, "models": []}}


def test_a_comparison_of_an_earlier_version_is_read_shown_and_written(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(json.dumps(EARLIER))
    found = legid.Comparison.read(tmp_path / "c.json")
    text = str(found)
    assert text.startswith("B IS BETTER (b.json)") and "nan" not in text
    assert "whole runs" in text and "diverged" in text and "0.400 .. 0.600" in text and "0.10000" not in text
    errors, parameters = found.to_frame(), found.to_frame("parameters")
    assert errors["horizon_s"].tolist() == [0.5, np.inf] and errors["a"].tolist() == [0.2, np.inf]
    assert np.isnan(parameters.loc["backlash@2 gap", "a"]) and parameters.loc["beta1", "b"] == 0.12
    assert "<td>whole runs</td><td>q1_rad</td><td>diverged</td>" in found._repr_html_()
    assert repr(found) == "<Comparison: B IS BETTER (b.json): at 2 of 2.>" and len(found.plot().axes) == 1
    found.page(tmp_path / "c.html")
    page = (tmp_path / "c.html").read_text()
    assert "<h2>Free-run errors over horizons</h2>" in page and "<h2>Free run of" not in page
    found.to_json(tmp_path / "again.json")
    assert json.loads((tmp_path / "again.json").read_text()) == EARLIER
