"""The programs that measure: each module below this folder that assigns `EVIDENCE`, and the page that lists them."""

import importlib
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from tests.support.paths import ROOT

HERE = Path(__file__).parent
PACKAGE = "evidence"
INDEX = ROOT / "docs/evidence/index.md"
DATE = r"\d{4}-\d\d-\d\d"
SEEDS = r"(?i)seeds? (?:from )?(\d+(?:(?: to |-)\d+)?)"
Result = Callable[[str], str]


class Evidence(NamedTuple):
    """One thing that is measured, for its line of the index."""

    what: str
    """The question, one line."""
    command: str
    """What a person types."""
    page: str
    """Below docs/evidence/. The program writes it, or a person copies its output into it."""
    minutes: float
    """Length with the command's own numbers on two idle cores."""
    target: str
    result: tuple[str, ...] | Result
    """The result from the page's text: patterns, each a part of the sentence by its groups or its whole match."""
    seeds: str = SEEDS
    date: str = DATE
    resumes: str = "yes"
    """Whether the command, stopped and called again, goes on where it stopped; else why not, or what it takes."""

    def line(self) -> str:
        """A row of the index. Raises ValueError where the page lacks the result."""
        text = (INDEX.parent / self.page).read_text(encoding="utf-8")
        parts = [self.result(text)] if callable(self.result) else [found(pattern, text) for pattern in self.result]
        if None in parts:
            raise ValueError(f"{self.page} has no result of `{self.command}`; correct `result` of its EVIDENCE")
        cells = (self.what, f"`{self.command}`", found(self.date, text) or "not stated",
                 found(self.seeds, text) or "none", "; ".join(filter(None, parts)), self.target,
                 f"[{self.page.removesuffix('.md')}]({self.page})")
        return f"| {' | '.join(cell.replace(' |', ':') for cell in cells)} |"


def found(pattern: str, text: str) -> str | None:
    """The groups of the first match, or all of it, as one line; None without a match."""
    match = re.search(pattern, text)
    if match is None:
        return None
    return " ".join(" ".join(match.groups() or [match[0]]).split())


def shares(pattern: str, what: str) -> Result:
    """A function from a page to `LOWEST to HIGHEST WHAT` over all matches of a pattern with one number."""
    def lowest_to_highest(text: str) -> str:
        values = [float(value) for value in re.findall(pattern, text)]
        if not values:
            raise ValueError(f"nothing matches {pattern}")
        return f"{min(values):g} to {max(values):g} {what}"
    return lowest_to_highest


@cache
def programs() -> dict[str, ModuleType]:
    """Name on the command line -> module, of every module with an `EVIDENCE`."""
    out = {}
    for path in sorted(HERE.rglob("*.py")):
        if re.search(r"^EVIDENCE = ", path.read_text(encoding="utf-8"), re.MULTILINE):
            name = ".".join(path.relative_to(HERE).with_suffix("").parts)
            out[name.replace("_", "-")] = importlib.import_module(f"{PACKAGE}.{name}")
    return out


def evidence() -> dict[str, tuple[Evidence, ...]]:
    """Name on the command line -> what that program measures."""
    found = {name: module.EVIDENCE for name, module in programs().items()}
    return {name: (one,) if isinstance(one, Evidence) else one for name, one in found.items()}


def index() -> str:
    """docs/evidence/index.md."""
    rows = sorted((one for many in evidence().values() for one in many), key=lambda one: (one.page, one.command))
    return "\n".join([
        "# Evidence", "",
        "Every measurement in one line. Dates and results are read from the pages. [Known limits](limits.md) has what "
        "does not work yet.", "",
        "`python -m evidence` lists the programs and their minutes. `python -m evidence NAME --help` gives "
        "the arguments of one. `python -m evidence --index` writes this page.", "",
        "| what | command | date | seeds | result | target | page |",
        "| --- | --- | --- | --- | --- | --- | --- |", *(row.line() for row in rows), "",
        "```{toctree}", ":hidden:", "", *sorted({row.page.removesuffix(".md") for row in rows}), "```", ""])
