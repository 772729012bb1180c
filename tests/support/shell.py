"""`legid` as it is typed: a command, the status that it must end with, and what it said."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from legid import cli

Answers = Callable[..., list[str]]


def typed(*words: object, status: int = 0) -> None:
    """`typed("fit", run, "--sensors imu --rig", rig)`: words are split at blanks, paths are not."""
    assert cli.main([part for word in words for part in (word.split() if isinstance(word, str) else [str(word)])]
                    ) == status


def document(*words: object, status: int = 0) -> Any:
    """The document that a command writes with `--json`."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "document.json"
        typed(*words, "--json", path, status=status)
        return read_json(path)


def read_json(path: Path) -> Any:
    """What a JSON file holds."""
    return json.loads(path.read_text())


def values(found: Any) -> np.ndarray:
    """Values of the parameters in the document of a fit."""
    return np.array([parameter["value"] for parameter in found["parameters"]])


class Shell:
    """Commands as `typed` takes them, and what they say."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self.read = capsys.readouterr

    def __call__(self, *words: object, status: int = 0) -> None:
        typed(*words, status=status)

    @property
    def out(self) -> str:
        """What was said since it was last read, without errors."""
        return self.read().out

    @property
    def err(self) -> str:
        """Errors since they were last read."""
        return self.read().err

    def fails(self, *words: object, status: int = 2) -> str:
        """The one line of a command that must fail, without those that a busy machine's progress adds."""
        self.read()
        self(*words, status=status)
        line = re.sub(r"(?m)^.* s so far\n", "", self.err)
        assert line.count("\n") == 1 and line.startswith("legid") and "Traceback" not in line, line
        return line
