"""Where commands are typed."""

from pathlib import Path

import pytest


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of its own, which is the current one: a command names its files as a user does."""
    monkeypatch.chdir(tmp_path)
    return tmp_path
