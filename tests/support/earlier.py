"""Documents as earlier versions wrote them."""

import json
from typing import Any

from tests.support.paths import ROOT

FOLDER = ROOT / "tests/experiments/documents/earlier"


def earlier(name: str) -> Any:
    """The content of NAME.json."""
    return json.loads((FOLDER / f"{name}.json").read_text())
