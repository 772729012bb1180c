"""`legid watch`: a line a run, alarms with names, arriving files, and what it refuses."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import legid
from evidence.blind.stickslip import MAKERS, Readings
from experiments import cli
from experiments.workflows import arrivals
from tests.support.changed_leg import REFERENCE, leg_runs
from tests.support.pages import Outside


def test_a_changed_gyro_alarms_in_its_first_run_and_is_named_by_the_second(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    seen: list[Readings] = []

    def late(c: Readings) -> None:  # runs 7 and 8 alone
        seen.append(c)
        if len(seen) > 2:
            MAKERS["gyro_scale"][0](1.0)(c)

    files, rig = leg_runs(tmp_path, late)
    out, page = tmp_path / "watch.json", tmp_path / "watch.html"
    later = tmp_path / "later"
    later.mkdir()
    for file in files[REFERENCE:]:
        shutil.move(file, later)
    broken = later / "r9.csv"
    broken.write_text("time_s,q2_rad\n0,0\n")
    words = ["--against", *map(str, files[:REFERENCE]), "--rig", str(rig)]
    assert cli.main(["watch", str(later), *words, "--json", str(out), "--html", str(page)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("r5.csv: ok; 10 s;") and lines[1].startswith("r6.csv: ok;")
    assert lines[2].startswith("r7.csv: ALARM after 5.0 s;") and "likeliest change gyro_scale" in lines[2]
    assert "The next run names the change" in lines[3]
    assert "2 runs since r7.csv: Changed: gyro_scale" in lines[5]
    assert any(line.startswith("r9.csv: not tested: ") for line in lines)
    assert lines[-1].endswith("2 with an alarm, first r7.csv")
    found = json.loads(out.read_text())
    assert [one["state"] for one in found["watched"]] == ["ok", "ok", "alarm", "alarm", "not tested"]
    assert all(one["recorded"] is None for one in found["watched"])  # a CSV file has no date
    last = found["watched"][3]
    assert last["change"]["verdict"] == "named"
    assert last["change"]["causes"][0]["size"][0]["value"] == pytest.approx(0.03, rel=0.15)
    assert last["alarm"]["per_hour"] < 0.1 and found["reference"]["runs"] == [f"r{k}.csv" for k in range(1, 5)]
    text = page.read_text()
    assert "The rig changed" in text and "<svg" in text and "r7.csv" in text
    outside = Outside()
    outside.feed(text)
    assert outside.found == []
    broken.unlink()
    assert_python_says_so(sorted(later.iterdir()), files[:REFERENCE], rig, found)


def assert_python_says_so(runs: list[Path], reference: list[Path], rig: Path, said: Any) -> None:
    """`legid.watch` gives what the command gave, but for the time that the search for the change took."""
    found = legid.watch(legid.load(runs, rig), legid.load(reference, rig))
    found.to_json(rig.parent / "python.json")
    told = json.loads((rig.parent / "python.json").read_text())
    assert told.pop("provenance")["runs"] == said["provenance"]["runs"][: len(runs)]
    for one in (*told["watched"], *said["watched"]):
        (one["change"] or {}).pop("wall_s", None)
    assert told == {key: value for key, value in said.items() if key != "provenance"} | {
        "watched": said["watched"][: len(runs)]}
    assert found.alarms[0] == "r7.csv" and told["watched"][3]["change"]["verdict"] == "named"
    assert list(found.to_frame()["state"]) == [one["state"] for one in told["watched"]]
    assert len(found.plot().axes) == 1 and "ALARM" in found._repr_html_()
    with pytest.raises(legid.InputError, match="at most 60 an hour"):
        legid.watch(legid.load(runs[:1], rig), legid.load(reference, rig), false_alarms=0.0)


def test_what_is_no_watch_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, said in (([str(tmp_path), "--against", str(tmp_path)], "holds no run file"),
                        (["a.csv", "--against", "m.json", "r.csv"], "is not the only reference")):
        assert cli.main(["watch", *words]) == 2
        assert said in capsys.readouterr().err
    assert cli.main(["watch", "a.csv", "--against", "b.csv", "--false-alarms", "0"]) == 2


def test_a_file_arrives_when_nobody_writes_it_any_more(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    (tmp_path / "old.csv").write_text("old")
    run, native = tmp_path / "run.csv", tmp_path / "run.mcap"
    rounds: list[int] = []

    def sleep(seconds: float) -> None:
        rounds.append(len(rounds))
        if len(rounds) in (1, 2):  # both grow
            with run.open("a") as a, native.open("ab") as b:
                a.write("more\n")
                b.write(rng.bytes(40))
        if len(rounds) == 4:
            with native.open("ab") as b:
                b.write(b"\x89MCAP0\r\n")
        if len(rounds) == 7:
            raise KeyboardInterrupt

    found = []
    with pytest.raises(KeyboardInterrupt):
        for file in arrivals([str(tmp_path)], [str(tmp_path / "old.csv")], True, sleep):
            found.append((Path(file).name, len(rounds)))
    assert found == [("run.csv", 3), ("run.mcap", 4)]
    with pytest.raises(Exception, match="does not exist"):
        next(arrivals([str(tmp_path / "none")], [], True))
