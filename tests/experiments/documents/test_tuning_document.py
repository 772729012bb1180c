"""`legid.tuning/1` as a struct: files of earlier versions are read and shown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import legid

EARLIER: dict[str, Any] = {
    "schema": "legid.tuning/1",
    "chosen": [{"table": "timing", "key": "torque_delay_s", "value": [0.003, 0.0005], "why": "how long after its stamp",
                "changes": "error of held-out runs 0.2 -> 0.1"},
               {"table": "sampling", "key": "rate_hz", "value": 200.0, "why": "the finest grid",
                "changes": "0.2 -> 0.1"}],
    "times": [{"what": "rate", "before": 100.0, "after": 200.0, "gain": 0.5},
              {"what": "hold", "before": "auto", "after": "auto", "gain": 0.0},
              {"what": "delay", "before": 0.0, "after": 0.003, "gain": None}],
    "tried": [{"entry": "[sampling] rate_hz", "value": "50", "error": "no prediction"}],
    "error_before": [0.2, 0.3], "error_after": [0.1, 0.15], "horizon_s": 1.0, "doubts": ["grids differ"],
    "set_aside": [{"run": "b.csv", "why": "it stands still"}], "damaged": [],
    "provenance": {"version": "0.1.0", "commit": "unknown", "runs": [], "rig": None, "model": None, "command": "",
                   "seed": None, "models": []}}


def test_a_tuning_of_an_earlier_version_is_read_shown_and_written(tmp_path: Path) -> None:
    (tmp_path / "t.json").write_text(json.dumps(EARLIER))
    found = legid.Tuning.read(tmp_path / "t.json")
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
    found.to_json(tmp_path / "again.json")
    assert json.loads((tmp_path / "again.json").read_text()) == EARLIER


def test_nothing_is_chosen_where_no_fit_predicts(tmp_path: Path) -> None:
    failed = {**EARLIER, "chosen": [], "times": [], "error_before": [None], "error_after": [None]}
    (tmp_path / "t.json").write_text(json.dumps(failed))
    found = legid.Tuning.read(tmp_path / "t.json")
    assert not found.predicts and str(found).startswith("nothing is chosen: no fit to half")
    with pytest.raises(legid.WorkError, match="record richer motion"):
        found.plot()
