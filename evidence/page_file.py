"""The page of a study: its options, and the cases that its minutes hold."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

Case = TypeVar("Case")


def within(minutes: float, cases: Iterable[Case]) -> Iterator[Case]:
    """`cases`, until so many minutes are over."""
    end_s = time.monotonic() + 60.0 * minutes
    for case in cases:
        if time.monotonic() > end_s:
            return
        yield case


def write_page(page: Callable[..., Iterator[str]], told: str | None, arguments: Sequence[str] | None,
               **options: tuple[float | str, str]) -> None:
    """Print the lines of `page` and write them to `--out`; it is called with `options`: default and help of each."""
    parser = argparse.ArgumentParser(description=told)
    parser.add_argument("--out", type=Path, required=True)
    for name, (default, words) in options.items():
        parser.add_argument(f"--{name}", type=type(default), default=default, help=words)
    given = vars(parser.parse_args(arguments))
    out: Path = given.pop("out")
    lines = list(page(**given))
    print("\n".join(lines))
    out.write_text("\n".join(lines), encoding="utf-8")
