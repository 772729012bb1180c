"""`legid runs`: recorded runs with dates, losses and verdicts, chosen by filters."""

import json
import os
from collections.abc import Mapping
from pathlib import Path

import pytest

from daq.runs import RunWriter
from estimator import VERDICTS, Verdict
from tests.support.shell import Shell, document

RIG = '[mechanism]\nmodel = "{model}"\nactuated = [2]\n'
DAY_NS = 86_400 * 10**9
FIRST_DAY = 1_767_225_600 * 10**9  # 2026-01-01 00:00:00 UTC


def write_run(path: Path, day: int, seconds: float, model: str = "leg2", lost: int = 0, gaps: int = 0,
              event: tuple[str, str] | None = None) -> None:
    """Telemetry at 100 Hz of which `lost` frames are missing, clock probes with a round trip of 100 us."""
    path.parent.mkdir(parents=True, exist_ok=True)
    facts = {"started_unix_ns": str(FIRST_DAY + (day - 1) * DAY_NS)}
    writer = RunWriter(path, {"rig.toml": RIG.format(model=model)}, facts)
    for k in range(round(seconds * 100) + 1):
        t = 10**9 + k * 10**7
        if not 10 <= k < 10 + lost:
            writer.add("/leg/telemetry", t, t, 0.0, 0.0, 0.0, 0.0, 24.0, 30.0, 0.0, k * 10_000, 7, k, 0, 0)
        if k % 10 == 0:
            writer.add("/leg/clock", t, t, t + 100_000, k * 10_000 + 50, k * 10_000 + 50, 7, k)
    for k in range(5):
        writer.add("/imu", k, k, k + 1, k, 0, 0, 0, 0, 0, 0, int(k < gaps))
    if event:
        writer.event(10**9, *event)
    writer.close()


def write_diagnosis(path: Path, verdict: str, runs: Mapping[str, list[str]], causes: list[dict[str, object]],
                    age_s: float = 0.0) -> None:
    path.write_text(json.dumps({"schema": "legid.diagnosis/1", "verdict": verdict, "causes": causes, "runs": runs,
                                "gain": {}, "wall_s": 1.0}))
    os.utime(path, (2e9 - age_s, 2e9 - age_s))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_run(tmp_path / "b.mcap", 3, 1.0, lost=4)
    write_run(tmp_path / "a.mcap", 5, 2.0, event=("limit q1_rad", "q1 is 1.7 rad; stop sent"))
    write_run(tmp_path / "deep/a.mcap", 1, 1.5, model="chain", gaps=2)
    (tmp_path / "broken.mcap").write_bytes(b"not a run")
    (tmp_path / "model.json").write_text('{"schema": "legid.model/1"}')
    (tmp_path / "other.json").write_text("[1, 2")
    write_diagnosis(tmp_path / "old.json", "none", {"fit": ["a.mcap", "b.mcap"]}, [], age_s=100)
    write_diagnosis(tmp_path / "new.json", "named", {"fit": ["x.mcap"], "confirm": ["a.mcap"]},
                    [{"effect": "backlash", "joint": 2, "size": []}, {"effect": "gyro_bias", "joint": None}])
    return tmp_path


def listed(folder: Path, *more: str) -> list[dict[str, object]]:
    found = document("runs", folder, *more)
    assert found["schema"] == "legid.runs/1"
    return list(found["runs"])


def test_every_run_with_what_is_known_of_it(folder: Path, shell: Shell) -> None:
    runs = listed(folder)
    assert [r["file"] for r in runs] == ["deep/a.mcap", "b.mcap", "a.mcap", "broken.mcap"]
    chain, b, a, broken = runs
    assert str(a["recorded"]).startswith("2026-01-05T00:00:00")
    assert a["seconds"] == pytest.approx(2.0)
    assert (a["model"], chain["model"]) == ("leg2", "chain")
    assert a["clock_bound_s"] == pytest.approx(50e-6, abs=5e-6)  # half the round trip
    assert (b["frames_lost"], a["frames_lost"]) == (4, 0)
    assert (chain["imu_gaps"], a["imu_gaps"]) == (2, 0)
    assert a["ended"] == "limit q1_rad"
    assert "not readable" in str(broken["ended"])
    assert (a["verdict"], a["diagnosis"], a["causes"]) == ("named", "new.json", ["backlash@2", "gyro_bias"])
    assert (b["verdict"], b["diagnosis"]) == ("none", "old.json")
    assert chain["verdict"] is None  # its namesake in the folder above was diagnosed, not this one
    text = shell.out
    assert "named backlash@2 gyro_bias" in text and "2026-01-03 00:00:00" in text and "4 runs" in text


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_is_a_filter(verdict: Verdict, tmp_path: Path) -> None:
    write_run(tmp_path / "a.mcap", 1, 1.0)
    write_run(tmp_path / "b.mcap", 2, 1.0)
    write_diagnosis(tmp_path / "d.json", verdict, {"fit": ["b.mcap"]}, [])
    assert [r["file"] for r in listed(tmp_path, "--verdict", verdict)] == ["b.mcap"]


@pytest.mark.parametrize(("filters", "files"), [
    ("--model leg2", ["b.mcap", "a.mcap"]),
    ("--since 2026-01-03", ["b.mcap", "a.mcap"]),
    ("--until 2026-01-03", ["deep/a.mcap", "b.mcap"]),
    ("--since 2026-01-02 --until 2026-01-04", ["b.mcap"]),
    ("--verdict named", ["a.mcap"]),
    ("--verdict -", ["deep/a.mcap", "broken.mcap"]),
    ("--faulty --model leg2 --verdict none", ["b.mcap"]),
    ("--model joint1", []),
])
def test_filters(folder: Path, filters: str, files: list[str], shell: Shell) -> None:
    assert [r["file"] for r in listed(folder, filters)] == files
    assert f"{len(files)} of 4 runs" in shell.out


def test_a_run_that_is_whole_is_not_faulty(tmp_path: Path) -> None:
    write_run(tmp_path / "good.mcap", 1, 1.0)
    cut = tmp_path / "cut.mcap"
    write_run(cut, 2, 1.0)
    cut.write_bytes(cut.read_bytes()[:-200])
    assert [(r["file"], r["ended"]) for r in listed(tmp_path, "--faulty")] == [("cut.mcap", "file cut off")]


def test_bad_arguments_are_one_line(here: Path, shell: Shell) -> None:
    shell.fails("runs nowhere")
    shell.fails("runs", here, "--since yesterday")
    shell("runs", here)
    assert shell.out == "0 runs\n"
