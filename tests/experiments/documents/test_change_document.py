"""`legid.diagnosis/1` with `against` and `legid.sessions/1` as structs: earlier files are read."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import legid
from tests.support.earlier import FOLDER, again, earlier

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
    found.page(tmp_path / "page.html")  # which needs no motion
    page = (tmp_path / "page.html").read_text()
    assert "<svg" in page and "b.csv is damaged: the end" in page and "encoder_offset, joint 2" in page
    assert again(found) == CHANGE
    with pytest.raises(legid.InputError, match="against"):
        legid.Change.read(written(tmp_path, {k: v for k, v in CHANGE.items() if k != "against"}))


def test_sessions_of_an_earlier_version_are_read_shown_and_written(tmp_path: Path) -> None:
    found = legid.Sessions.read(FOLDER / "sessions.json")
    assert str(found).splitlines()[4].split() == ["A", "C", "no_change", "No", "difference."]
    assert found.verdict == "named" and found.pairs[1].a.name == "A" and len(found.plot().axes) == 1
    assert found.to_frame()[["from", "to", "value"]].values.tolist() == [["A", "B", 0.03]]
    assert len(found.to_frame("candidates")) == 4 and "<p>No difference</p>" in found._repr_html_()
    found.page(tmp_path / "page.html")
    assert "B against A: Changed" in (tmp_path / "page.html").read_text()
    kept = again(found)
    assert [pair.pop("wall_s") for pair in kept["pairs"]] == [0.0, 0.0] and kept == SESSIONS
    one = legid.Sessions.read(written(tmp_path, {**SESSIONS, "pairs": SESSIONS["pairs"][1:]}))
    assert "From A to B:" in str(one) and "from" not in one.to_frame()
