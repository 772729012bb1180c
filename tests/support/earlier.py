"""Documents as earlier versions wrote them."""

import json
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.support.paths import ROOT

FOLDER = ROOT / "tests/experiments/documents/earlier"


def earlier(name: str) -> Any:
    """The content of NAME.json."""
    return json.loads((FOLDER / f"{name}.json").read_text())


def again(found: Any) -> Any:
    """What its `to_json` writes."""
    return json.loads(written_by(found.to_json))


def written_by(write: Callable[[Path], object]) -> str:
    """The text of the file that it writes: `written_by(result.page)`."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "written"
        write(path)
        return path.read_text()
