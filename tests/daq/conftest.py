"""What the rooms of daq share."""

from pathlib import Path

import pytest


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The run file that a test writes."""
    return tmp_path / "r.mcap"
