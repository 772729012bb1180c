"""Write docs/schemas: the JSON Schema of each document. `python -m tests.tools.schemas`"""

import json

from tests.support.documented import DOCUMENTED, json_schema
from tests.support.paths import ROOT

FOLDER = ROOT / "docs/schemas"


def schemas() -> dict[str, str]:
    """File name -> text."""
    return {f"legid.{name}-1.json": json.dumps(json_schema(kind), indent=1) + "\n" for name, kind in DOCUMENTED.items()}


def main() -> None:
    """Write them."""
    FOLDER.mkdir(exist_ok=True)
    for name, text in schemas().items():
        (FOLDER / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
