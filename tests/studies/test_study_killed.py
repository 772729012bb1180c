"""A study that is killed half way, or whose code has changed: what is done again, and what is not."""

import json
import time
from pathlib import Path

import pytest
from numpy.testing import assert_array_equal

from experiments.workflows.executor import SerialExecutor
from legid.cli import main
from studies.biped3 import CASES, FLOOR, blocks, run_study, store
from studies.biped3.study import run_block
from tests.support.processes import REAL_CLOCK, of_session, start_python, until

pytestmark = REAL_CLOCK

WORK = blocks(CASES[1:2], ["wls", FLOOR], 300, 4)


def command(out: Path, *more: str) -> list[str]:
    return ["monte-carlo", "biped3", "--runs", "300", "--cases", "2", "--methods", "wls", "--seed", "4", "--out",
            str(out), *more]


@pytest.mark.slow
def test_kill_9_half_way_loses_nothing(tmp_path: Path) -> None:
    out, kept = tmp_path / "study", tmp_path / "study" / "blocks"
    process = start_python("-m", "legid.cli", *command(out, "--workers", "2"))
    deadline = time.monotonic() + 120.0
    while len(list(kept.glob("*.npz"))) < 4:
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.002)
    process.kill()
    process.communicate()
    assert until(lambda: not of_session(process.pid))  # nobody tells the workers, they notice
    finished = {path: path.stat().st_mtime_ns for path in kept.glob("*.npz")}
    assert 4 <= len(finished) < len(WORK)
    assert main(command(out, "--workers", "1", "--json", str(tmp_path / "table.json"))) == 0
    assert {path: path.stat().st_mtime_ns for path in finished} == finished
    for block in (WORK[0], WORK[-1]):
        found = store.load_block(kept, block)
        assert_array_equal(found.beta, run_block(block).beta)
    rows = json.loads((tmp_path / "table.json").read_text())["results"]
    assert {row["method"]: row["runs"] for row in rows} == {"wls": 300, "floor": 300}


def test_results_of_other_code_are_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    work = blocks(CASES[:1], [FLOOR], 5, 2)
    run_study(work, tmp_path, SerialExecutor(), lambda block, count: None)
    assert store.load_block(tmp_path, work[0]) is not None
    monkeypatch.setattr(store, "program", lambda: "another")
    assert store.load_block(tmp_path, work[0]) is None
