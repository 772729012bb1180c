"""Documents as earlier versions wrote them."""

import json
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
    with TemporaryDirectory() as folder:
        path = Path(folder) / "again.json"
        found.to_json(path)
        return json.loads(path.read_text())
