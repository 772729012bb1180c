"""Changes, sessions, comparisons and tunings as structs: files of earlier versions are read, shown and written."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import legid
from tests.support.earlier import FOLDER, again, earlier, written_by

CHANGE = earlier("change")
SESSIONS = earlier("sessions")


def written(folder: Path, document: dict[str, Any]) -> Path:
    (folder / "earlier.json").write_text(json.dumps(document))
    return folder / "earlier.json"


def test_a_change_of_an_earlier_version_is_read_shown_and_written(tmp_path: Path) -> None:
    found = legid.Change.read(FOLDER / "change.json")
    text = str(found)
    assert text.startswith(CHANGE["sentence"]) and "From the reference runs to these runs:" in text
    assert "0.029 .. 0.031" in text and "payload, link 2" in text and "none" in text and "nan" not in text
    assert "predicts 1 of 1 runs better" in text and text.endswith("Runs: reference a.csv, b.csv. (3 s)")
    assert found.to_frame()["high"].tolist() == [0.031] and repr(found) == f"<Change: {CHANGE['sentence']}>"
    candidates = found.to_frame("candidates")
    assert candidates["smallest_detectable"].tolist() == [0.001, np.inf] and np.isnan(candidates["low"][1])
    with pytest.raises(ValueError, match="neither"):
        found.to_frame("noise")
    assert len(found.plot().axes) == 1 and "Warning: look at it" in found._repr_html_()
    page = written_by(found.page)  # which needs no motion
    assert "<svg" in page and "b.csv is damaged: the end" in page and "encoder_offset, joint 2" in page
    assert again(found) == CHANGE
    with pytest.raises(legid.InputError, match="against"):
        legid.Change.read(written(tmp_path, {k: v for k, v in CHANGE.items() if k != "against"}))


def test_sessions_of_an_earlier_version_are_read_shown_and_written(tmp_path: Path) -> None:
    found = legid.Sessions.read(FOLDER / "sessions.json")
    assert str(found).splitlines()[4].split() == ["A", "C", "no_change", "No", "difference."]
    assert found.verdict == "named" and found.pairs[1].a.name == "A" and len(found.plot().axes) == 1
    assert found.to_frame()[["from", "to", "value"]].values.tolist() == [["A", "B", 0.03]]
    assert len(found.to_frame("candidates")) == 4 and "No difference" in found._repr_html_()
    assert "B against A: Changed" in written_by(found.page)
    kept = again(found)
    assert [pair.pop("wall_s") for pair in kept["pairs"]] == [0.0, 0.0] and kept == SESSIONS
    one = legid.Sessions.read(written(tmp_path, {**SESSIONS, "pairs": SESSIONS["pairs"][1:]}))
    assert "From A to B:" in str(one) and "from" not in one.to_frame()


def test_a_comparison_of_an_earlier_version_is_read_shown_and_written() -> None:
    found = legid.Comparison.read(FOLDER / "comparison.json")
    text = str(found)
    assert text.startswith("B IS BETTER (b.json)") and "nan" not in text
    assert "whole runs" in text and "diverged" in text and "0.400 .. 0.600" in text and "0.10000" not in text
    errors, parameters = found.to_frame(), found.to_frame("parameters")
    assert errors["horizon_s"].tolist() == [0.5, np.inf] and errors["a"].tolist() == [0.2, np.inf]
    assert np.isnan(parameters.loc["backlash@2 gap", "a"]) and parameters.loc["beta1", "b"] == 0.12
    assert repr(found) == "<Comparison: B IS BETTER (b.json): at 2 of 2.>" and len(found.plot().axes) == 1
    page = written_by(found.page)
    assert "<h2>Free-run errors over horizons</h2>" in page and "<h2>Free run of" not in page
    assert again(found) == earlier("comparison")


TUNING = earlier("tuning")


def test_a_tuning_of_an_earlier_version_is_read_shown_and_written() -> None:
    found = legid.Tuning.read(FOLDER / "tuning.json")
    text = str(found)
    assert text.startswith("2 entries of rig.toml chosen; rms prediction error over 1 s") and found.predicts
    assert "0.2 and 0.3 before, 0.1 and 0.15 after" in text and "[0.003, 0.0005]" in text
    assert "rate 200 Hz (instead of 100 Hz: error 50 % smaller), hold 'auto' (as it was), delay 3 ms" in text
    assert text.endswith("warning: b.csv is set aside: it stands still\nwarning: grids differ")
    assert found.to_frame()["chosen"].tolist() == ["[0.003, 0.0005]", "200"]
    assert found.to_frame("tried")["error"].tolist() == ["no prediction"] and len(found.plot().axes) == 1
    with pytest.raises(ValueError, match="neither"):
        found.to_frame("flags")
    assert repr(found).startswith("<Tuning: 2 entries")
    assert again(found) == TUNING


def test_nothing_is_chosen_where_no_fit_predicts(tmp_path: Path) -> None:
    failed = {**TUNING, "chosen": [], "times": [], "error_before": [None], "error_after": [None]}
    (tmp_path / "t.json").write_text(json.dumps(failed))
    found = legid.Tuning.read(tmp_path / "t.json")
    assert not found.predicts and str(found).startswith("nothing is chosen: no fit to half")
    with pytest.raises(legid.WorkError, match="record richer motion"):
        found.plot()
