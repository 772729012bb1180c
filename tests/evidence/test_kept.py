"""A piece of a study is measured once for one program, and anew for another."""

from pathlib import Path

import pytest

from evidence import kept as module
from evidence.kept import kept

called: list[tuple[int, str]] = []


@kept
def measured(seed: int, what: str = "all") -> dict[str, int]:
    called.append((seed, what))
    if seed < 0:
        raise ValueError("no such seed")
    return {what: seed * seed}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    called.clear()
    monkeypatch.setattr(module, "FOLDER", tmp_path)
    return tmp_path


def test_a_piece_that_is_there_is_not_measured_again(folder: Path) -> None:
    assert [measured(3), measured(3), measured(4), measured(3, what="some")] == [
        {"all": 9}, {"all": 9}, {"all": 16}, {"some": 9}]
    assert called == [(3, "all"), (4, "all"), (3, "some")]
    assert not list(folder.rglob("*.part")), "a file is whole or not there"


def test_another_program_measures_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    measured(3)
    monkeypatch.setattr(module, "source_hash", lambda: b"changed")
    assert measured(3) == {"all": 9} and len(called) == 2


def test_what_failed_is_tried_again() -> None:
    for _ in range(2):
        with pytest.raises(ValueError, match="no such seed"):
            measured(-1)
    assert len(called) == 2
