"""Files that commands write, and the words they print about them."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

from daq import InputError, write_file

T = TypeVar("T")


def program_version() -> str:
    """The installed version, or `unknown` where the package is not installed."""
    try:
        return version("legid")
    except PackageNotFoundError:
        return "unknown"


def write_text(path: Path | str, text: str) -> None:
    """Write a text file as `daq.files` does: whole or not at all, never over a run. Raises `InputError`."""
    write_file(path, text.encode())


def write_json(path: Path | str, document: Any) -> None:
    """Write `document` as indented JSON; a number that is not finite becomes null."""
    import msgspec

    write_text(path, msgspec.json.format(msgspec.json.encode(document), indent=2).decode() + "\n")


def make_directory(path: Path) -> None:
    """Make `path` with its parents. Raises `InputError`."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), "give a place that can be written") from None


def progress(items: Iterable[T], label: str, total: int | None = None, unit: str = "it") -> Iterable[T]:
    """`items` behind a progress bar on a terminal; nothing is shown when stderr is a file or a pipe."""
    from tqdm import tqdm

    return tqdm(items, desc=label, total=total, unit=unit, leave=False, disable=None)


@contextmanager
def progress_to(label: str) -> Iterator[Callable[[float, float], None]]:
    """A function (done, total), both in seconds, that moves a progress bar on a terminal."""
    from tqdm import tqdm

    with tqdm(desc=label, total=1.0, leave=False, disable=None,
              bar_format="{desc} {percentage:3.0f}%|{bar}| {n:.0f}/{total:.0f} s") as bar:
        def show(done: float, total: float) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield show


@contextmanager
def stages(label: str) -> Iterator[Callable[[str, float], None]]:
    """A function (stage, fraction done) that names the stage and moves a progress bar on a terminal."""
    from tqdm import tqdm

    with tqdm(desc=label, total=1.0, leave=False, disable=None,
              bar_format="{desc} {percentage:3.0f}%|{bar}| {elapsed}") as bar:
        def show(stage: str, fraction: float) -> None:
            bar.set_description_str(f"{label}: {stage}")
            bar.update(fraction - bar.n)

        yield show


@contextmanager
def work_bar(label: str, total: int, unit: str) -> Iterator[Callable[[int, str], None]]:
    """A function (pieces done, what they were) that moves a bar with the time left.

    On a terminal a bar; otherwise a line on stderr at most every ten seconds, for logs of long studies.
    """
    import time

    from tqdm import tqdm

    terminal = sys.stderr.isatty()
    started = last = time.monotonic()
    finished = 0
    with tqdm(desc=label, total=total, unit=unit, leave=False, disable=not terminal, smoothing=0.05) as bar:
        def show(count: int, what: str) -> None:
            nonlocal finished, last
            finished += count
            bar.set_postfix_str(what, refresh=False)
            bar.update(count)
            now = time.monotonic()
            if not terminal and now - last >= 10.0:
                last = now
                left = (now - started) / finished * (total - finished)
                print(f"{label}: {finished} of {total} {unit}s, about {left:.0f} s left ({what})", file=sys.stderr)

        yield show


@contextmanager
def busy(label: str) -> Iterator[None]:
    """`label` with the seconds counting up on a terminal, for work that cannot tell how far it is."""
    if not sys.stderr.isatty():
        yield
        return
    from tqdm import tqdm

    done = threading.Event()
    with tqdm(desc=label, bar_format="{desc} ... {elapsed}", leave=False) as bar:
        def tick() -> None:
            while not done.wait(0.5):
                bar.refresh()

        ticker = threading.Thread(target=tick, name="progress", daemon=True)
        ticker.start()
        try:
            yield
        finally:
            done.set()
            ticker.join()


def text_table(header: list[str], rows: list[list[str]], right: set[int]) -> str:
    """Columns lined up for a terminal; those numbered in `right` on their right edge."""
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]

    def line(cells: list[str]) -> str:
        return "  ".join(c.rjust(w) if i in right else c.ljust(w)
                         for i, (c, w) in enumerate(zip(cells, widths))).rstrip()

    return "\n".join([line(header), line(["-" * w for w in widths]), *map(line, rows)])
