"""`legid.tuning/1` as a struct: files of earlier versions are read and shown."""

import json
from pathlib import Path

import pytest

import legid
from tests.support.earlier import FOLDER, again, earlier

EARLIER = earlier("tuning")


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
    assert "<td>[sampling] rate_hz</td>" in found._repr_html_() and repr(found).startswith("<Tuning: 2 entries")
    assert again(found) == EARLIER


def test_nothing_is_chosen_where_no_fit_predicts(tmp_path: Path) -> None:
    failed = {**EARLIER, "chosen": [], "times": [], "error_before": [None], "error_after": [None]}
    (tmp_path / "t.json").write_text(json.dumps(failed))
    found = legid.Tuning.read(tmp_path / "t.json")
    assert not found.predicts and str(found).startswith("nothing is chosen: no fit to half")
    with pytest.raises(legid.WorkError, match="record richer motion"):
        found.plot()
