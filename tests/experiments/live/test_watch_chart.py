"""The dashboard's chart over weeks: which runs it shows, where, and what it links to. No browser."""

import asyncio
import os
import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from xml.etree import ElementTree

import pytest

from daq.rig import read_rig_file
from daq.runs import RunWriter, started_at
from estimator.change import Block
from estimator.change import WatchedRun as FoundRun
from experiments.documents import WatchDocument, WatchedRun
from experiments.live.bench import Bench
from experiments.live.watch_chart import Mark, anchor, draw_marks, explain_marks, read_marks
from tests.support.paths import DEMO_RIG

DAY = datetime(2026, 3, 2, 9, 30, tzinfo=UTC)


def watched(run: str, week: int | None, *per_hour: float, alarm: bool = False) -> WatchedRun:
    """A run of that week after the first; None: of a file without a date."""
    blocks = tuple(Block(5.0 * k, 5.0, value, "gyro_scale", None, 5.0) for k, value in enumerate(per_hour, 1))
    found = FoundRun(run, blocks, min(blocks, key=lambda b: b.per_hour) if alarm else None)
    return WatchedRun.of(found, None, None if week is None else DAY + timedelta(weeks=week))


def write(path: Path, lines: Sequence[WatchedRun], age_s: float = 0.0, false_alarms: float = 0.1) -> None:
    found = WatchDocument.begun(["old.mcap"], false_alarms)
    found.watched += lines
    found.to_json(path)
    os.utime(path, (2e9 - age_s, 2e9 - age_s))


def test_marks_come_from_the_newest_document_of_each_run_in_the_order_of_their_dates(tmp_path: Path) -> None:
    write(tmp_path / "old.json", [watched("a.mcap", 0, 50.0), watched("b.mcap", 1, 40.0)], 100.0, 1.0)
    write(tmp_path / "new.json", [watched("c.mcap", 3, 9.0, 1e-4, alarm=True), watched("b.mcap", 1, 7.0, 3.0),
                                  watched("undated.mcap", None, 8.0), watched("idle.mcap", 2)])
    (tmp_path / "fit.json").write_text('{"schema": "legid.fit/1"}')
    (tmp_path / "cut.json").write_text('{"schema": "legid.watch/1", "watched": [')
    marks = read_marks(tmp_path)
    assert [(m.run, m.per_hour, m.threshold, m.state) for m in marks] == [
        ("a.mcap", 50.0, 1.0, "ok"), ("b.mcap", 3.0, 0.1, "ok"), ("c.mcap", 1e-4, 0.1, "alarm")]
    assert marks[2].recorded == DAY + timedelta(weeks=3) and marks[2].change == "gyro_scale"
    assert read_marks(tmp_path / "nothing") == ()


def places(svg: str) -> dict[str, tuple[float, float, str]]:
    """Run -> x, y and shape of its point."""
    out = {}
    for link in ElementTree.fromstring(svg).iter("a"):
        point = link[-1]
        x, y = (point.get("cx"), point.get("cy")) if point.tag == "circle" else re.findall(
            r"[-\d.]+", point.get("d", ""))[:2]
        out[link.get("href", "").removeprefix("#run-")] = (float(x or 0), float(y or 0), point.tag)
    return out


def test_the_chart_puts_runs_at_their_dates_and_alarms_below_the_threshold(tmp_path: Path) -> None:
    write(tmp_path / "w.json", [watched("a.mcap", 0, 20.0), watched("b.mcap", 1, 0.11), watched(
        "c.mcap", 4, 1e-30, alarm=True)])
    marks = read_marks(tmp_path)
    svg = draw_marks(marks)
    at = places(svg)
    assert list(at) == ["a.mcap", "b.mcap", "c.mcap"]
    assert (at["b.mcap"][0] - at["a.mcap"][0]) * 3 == pytest.approx(at["c.mcap"][0] - at["b.mcap"][0], abs=0.5)
    line = re.search(r'class="limit" points="([^"]*)"', svg)
    assert line is not None
    (limit,) = {float(point.split(",")[1]) for point in line[1].split()}
    assert at["a.mcap"][1] < at["b.mcap"][1] < limit < at["c.mcap"][1] - 20.0  # down is less likely by chance
    assert [shape for *_, shape in at.values()] == ["circle", "circle", "path"]
    assert "2026-03-02" in svg and "2026-03-30" in svg and "3 runs" in svg
    assert explain_marks(marks).startswith("3 runs from 2026-03-02 to 2026-03-30: 1 with an alarm, the last c.mcap.")


def test_one_run_and_a_strange_name_can_be_drawn() -> None:
    mark = Mark('<&".mcap', DAY, 0.5, 0.1, "changed", "payload@2")
    (link,) = ElementTree.fromstring(draw_marks([mark])).iter("a")
    assert link.get("href") == "#" + anchor(mark.run) and "payload@2" in (link[0].text or "")
    assert link[-1].get("class") == "changed"


def test_the_bench_reads_new_documents_unless_it_records(tmp_path: Path) -> None:
    async def look() -> tuple[Mark, ...]:
        bench = Bench(read_rig_file(DEMO_RIG), tmp_path, tmp_path)
        bench.look_for_marks()
        bench.look_for_marks()  # not again so soon
        assert len(bench._tasks) == 1
        await asyncio.gather(*bench._tasks)
        return bench.marks

    write(tmp_path / "w.json", [watched("a.mcap", 0, 20.0)])
    assert [mark.run for mark in asyncio.run(look())] == ["a.mcap"]


def test_a_native_run_says_when_it_was_recorded(tmp_path: Path) -> None:
    for name, facts in (("dated", {"started_unix_ns": str(int(DAY.timestamp()) * 10**9)}), ("undated", {})):
        RunWriter(tmp_path / f"{name}.mcap", {}, facts).close()
    assert started_at(tmp_path / "dated.mcap") == DAY and started_at(tmp_path / "undated.mcap") is None
