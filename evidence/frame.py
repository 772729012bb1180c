"""The frame of a study: arguments, the cases that its minutes hold, tables, shares, the page with how it was made.

A study is a generator of its page's blocks, the title first: headings, paragraphs, points of a list, tables. Its
arguments with their defaults are those of the command line, and what it returns is the exit status.

    def page(minutes: float = 20.0, seed: int = 6500) -> Lines: ...
    main = program(page)
"""

import argparse
import inspect
import re
import sys
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from evidence.blind.score import Rate
from studies import machine

Case = TypeVar("Case")
Lines = Generator[str, None, Any]
"""Blocks of a page, and the exit status."""
WORDS = {"minutes": "after which no other case is begun", "seed": "of the first case", "fits": "of each row",
         "legs": "at most", "snapshots": "a folder with a clone of each public repository"}


def within(minutes: float, cases: Iterable[Case]) -> Iterator[Case]:
    """`cases`, until so many minutes are over."""
    end_s = time.monotonic() + 60.0 * minutes
    for case in cases:
        if time.monotonic() > end_s:
            return
        yield case


def tell(*what: object) -> None:
    """What came of a case, while the others go on."""
    print(*what, sep=" | ", file=sys.stderr, flush=True)


def share(hits: Iterable[object]) -> str:
    """`k/n = p % (low to high)`, by the 95 % interval of Wilson; a dash without cases."""
    every = [bool(hit) for hit in hits]
    return str(Rate(sum(every), len(every))) if every else "-"


@contextmanager
def new_folder() -> Iterator[Path]:
    """An empty folder, which is gone afterwards."""
    with TemporaryDirectory() as place:
        yield Path(place)


@contextmanager
def heard() -> Iterator[StringIO]:
    """What is printed meanwhile, errors too."""
    with redirect_stdout(StringIO()) as said, redirect_stderr(said):
        yield said


def table(titles: str, rows: Iterable[str | Iterable[object]]) -> str:
    """A table; `titles` and rows of text have a bar between cells."""
    cells = (row if isinstance(row, str) else " | ".join(str(cell).replace("|", "/") for cell in row) for row in rows)
    return "\n".join([f"| {titles} |", f"|{' --- |' * (titles.count('|') + 1)}", *(f"| {row} |" for row in cells)])


def joined(blocks: Iterable[str]) -> str:
    """A page: an empty line between blocks, none between the points of a list."""
    return re.sub(r"^(- .*)\n\n(?=- )", r"\1\n", "\n\n".join(blocks), flags=re.MULTILINE)


def program(page: Callable[..., Lines]) -> Callable[[Sequence[str]], int]:
    """`main` of a study: prints its page with command, date and machine below the title, and writes it to `--out`."""
    module = sys.modules[page.__module__]

    def main(arguments: Sequence[str] = ()) -> int:
        name = page.__module__.removeprefix("evidence.").replace("_", "-")
        parser = argparse.ArgumentParser(prog=f"python -m evidence {name}", description=module.__doc__,
                                         formatter_class=argparse.RawDescriptionHelpFormatter)
        parser.add_argument("--out", type=Path, help="the page to write, too")
        defaults = {key: one.default for key, one in inspect.signature(page).parameters.items()}
        for key, value in defaults.items():
            many = isinstance(value, tuple)
            parser.add_argument(f"--{key.replace('_', '-')}", default=value, help=WORDS.get(key),
                                nargs="*" if many else None, type=type((*value, "")[0] if many else value))
        given = vars(parser.parse_args(arguments))
        out: Path | None = given.pop("out")
        told = [f"--{key.replace('_', '-')} {' '.join(map(str, v)) if isinstance(v, tuple | list) else v}"
                for key, v in given.items() if v != defaults[key]]
        (title, *blocks), status = _exhausted(page(**given))
        seeds = f" (seed {given['seed']})" if "seed" in given else ""
        made = f"Made by `{' '.join([parser.prog, *told])}`{seeds}, {datetime.now(UTC):%Y-%m-%d}, {machine()}."
        text = f"{joined([title, made, *blocks])}\n"
        print(text)
        if out is not None:
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(text, encoding="utf-8")
        return status

    return main


def _exhausted(lines: Lines) -> tuple[list[str], int]:
    found = []
    while True:
        try:
            found.append(next(lines))
        except StopIteration as end:
            return found, int(bool(end.value))
