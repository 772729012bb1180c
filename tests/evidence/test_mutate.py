"""The study of broken files finds the faults that it is for."""

import os
from pathlib import Path

import pytest

from daq import InputError
from evidence.mutate_worker import Kind, study
from tests.support.processes import evidence


def read_wrongly(path: Path) -> None:
    """A reader with a mistake at some numbers."""
    number = int(path.read_text())
    if number == 3:
        raise ValueError("a mistake")
    if number == 5:
        os.kill(os.getpid(), 11)
    if number == 7:
        list(range(200_000_000))  # 1.6 GB
    if number % 2:
        raise InputError("x", "is odd", "none")


def put(number: int, path: Path) -> None:
    path.write_text(str(number))


def test_an_exception_a_crash_and_too_much_memory_are_faults(tmp_path: Path) -> None:
    kind = Kind("x", tmp_path / "file", put, read_wrongly)
    counts, faults = study(kind, 0, 12)
    assert [fault.number for fault in faults] == [3, 5, 7]
    assert [counts[key] for key in ("read", "refused", "stopped")] == [6, 5, 1]
    assert "ValueError: a mistake" in faults[0].what and "crashed" in faults[1].what
    assert "MemoryError" in faults[2].what


@pytest.mark.slow
def test_broken_files_are_read_or_refused_within_their_bounds() -> None:
    said = evidence("mutate", "--files", 60, "--chunk", 60)
    assert said.count("| 60 |") == 17 and "1,020 files have 0 faults" in said
