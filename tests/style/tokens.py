"""The ratchet: code tokens of each shipped package, which only fall.

    python -m tests.style.tokens           # the counts
    python -m tests.style.tokens --lower   # write them to pyproject.toml, where they are lower

Docstrings, comments and blank space do not count.
"""

import ast
import io
import re
import sys
import tokenize
import tomllib
from collections.abc import Iterator
from pathlib import Path

from tests.support.paths import ROOT

SKIPPED = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING,
           tokenize.ENDMARKER}
SETTINGS = ROOT / "pyproject.toml"


def tokens(text: str) -> int:
    """Code tokens of a Python source."""
    docs = {node.body[0].lineno for node in ast.walk(ast.parse(text))
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            and node.body and isinstance(node.body[0], ast.Expr) and isinstance(node.body[0].value, ast.Constant)
            and isinstance(node.body[0].value.value, str)}
    return sum(token.type not in SKIPPED and not (token.type == tokenize.STRING and token.start[0] in docs)
               for token in tokenize.generate_tokens(io.StringIO(text).readline))


def counted(package: Path) -> int:
    """Code tokens of all files below a folder."""
    return sum(tokens(path.read_text(encoding="utf-8")) for path in package.rglob("*.py"))


def allowed() -> dict[str, int]:
    """Package to the most code tokens that it may have, from pyproject.toml."""
    limits: dict[str, int] = tomllib.loads(SETTINGS.read_text(encoding="utf-8"))["tool"]["legid"]["tokens"]
    return limits


def beyond(counts: dict[str, int], limits: dict[str, int]) -> Iterator[str]:
    """A line for each package with more code tokens than its limit."""
    for package, count in counts.items():
        if count > limits[package]:
            yield (f"{package}: {count:,} code tokens, {count - limits[package]:,} more than pyproject.toml allows; "
                   "delete as much as you add")


def problems() -> Iterator[str]:
    """Every line that `make lint` prints about size."""
    limits = allowed()
    yield from beyond({package: counted(ROOT / package) for package in limits}, limits)


def lower() -> None:
    """Write the counts that are below their limits to pyproject.toml."""
    text = SETTINGS.read_text(encoding="utf-8")
    for package, limit in allowed().items():
        text = re.sub(rf"^{package} = {limit}$", f"{package} = {min(limit, counted(ROOT / package))}", text,
                      flags=re.MULTILINE)
    SETTINGS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    if "--lower" in sys.argv:
        lower()
    counts = {package: counted(ROOT / package) for package in allowed()}
    for package, count in {**counts, "together": sum(counts.values())}.items():
        print(f"{package:12} {count:8,}")
