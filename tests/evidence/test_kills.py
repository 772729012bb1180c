"""A short run of the study of killed recordings, and what it calls a fault."""

import signal
from pathlib import Path

import pytest

from daq.runs import read_run
from evidence import kills
from evidence.mutate import leg_run
from tests.support.processes import REAL_CLOCK, evidence

pytestmark = REAL_CLOCK


@pytest.mark.slow
def test_killed_recordings_are_read_and_recovered(tmp_path: Path) -> None:
    out = tmp_path / "kills.md"
    evidence("kills", "--kills", 8, "--disturbed", 4, "--out", out)
    assert out.read_text().count("| faults | 0 |") == 2


def test_what_is_a_fault(tmp_path: Path) -> None:
    whole = leg_run(tmp_path / "whole.mcap")

    def judged(data: bytes, given: int, handed: int) -> str:
        (tmp_path / "cut.saved.mcap").unlink(missing_ok=True)
        path = tmp_path / "cut.mcap"
        path.write_bytes(data)
        return kills._judge(path, -signal.SIGKILL, given, handed, "").fault

    cut = whole[: len(whole) // 2]
    (tmp_path / "half.mcap").write_bytes(cut)
    held = read_run(tmp_path / "half.mcap").messages
    assert held > 0 and judged(cut, held + 9, held) == ""
    assert "had been handed over" in judged(cut, held + 9, held + 1)
    damaged = bytearray(cut)
    damaged[len(cut) // 2] ^= 0xFF  # within a chunk
    assert judged(bytes(damaged), held + 9, held) != ""
    assert "refused" in judged(b"", 9, 9) and judged(b"", 9, 0) == ""
