"""`legid.comparison/1` as a struct: files of earlier versions are read and shown."""

from pathlib import Path

import numpy as np

import legid
from tests.support.earlier import FOLDER, again, earlier


def test_a_comparison_of_an_earlier_version_is_read_shown_and_written(tmp_path: Path) -> None:
    found = legid.Comparison.read(FOLDER / "comparison.json")
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
    assert again(found) == earlier("comparison")
