"""Constants of `estimator.fitting` say what they are."""

import ast
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

from estimator import fitting


def without_text(source: str) -> Iterator[str]:
    """Constants with a number in them, at the level of the module, that no string follows."""
    body: list[ast.stmt | None] = [*ast.parse(source).body, None]
    for one, after in pairwise(body):
        if isinstance(one, ast.Assign) and any(isinstance(part, ast.Constant) and isinstance(part.value, int | float)
                                               for part in ast.walk(one.value)):
            named = ast.unparse(one.targets[0])
            if named.isupper() and not (isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)):
                yield named


def test_a_constant_without_a_text_is_found() -> None:
    assert list(without_text("A = 1\nB, C = 2, 3\n\"\"\"Two.\"\"\"\nD = 4\n")) == ["A", "D"]


def test_every_constant_has_a_text() -> None:
    files = sorted(Path(fitting.__file__).parent.glob("*.py"))
    assert len(files) > 30
    assert [(file.name, name) for file in files for name in without_text(file.read_text(encoding="utf-8"))] == []
