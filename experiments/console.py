"""Files that commands write, and the words they print about them."""

from __future__ import annotations

import re
import shlex
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence, Sized
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeVar

from daq import input_errors, write_file

T = TypeVar("T")
QUIET, USUAL, VERBOSE = -1, 0, 1
FIRST_LINE_S, LINE_EVERY_S = 5.0, 10.0
"""Where stderr is no terminal, a long work says after so long what it is at, and then again after so long."""
_command: ContextVar[str] = ContextVar("command", default="")
_verbosity: ContextVar[int] = ContextVar("verbosity", default=USUAL)


@contextmanager
def verbosity(level: int) -> Iterator[None]:
    """Within it notes and progress are left out (`QUIET`), or details told (`VERBOSE`)."""
    token = _verbosity.set(level)
    try:
        yield
    finally:
        _verbosity.reset(token)


@contextmanager
def commanded(arguments: Sequence[str]) -> Iterator[None]:
    """Within it results are said to come of `legid ARGUMENTS`; of paths the last part is kept: folders are the
    user's own."""
    words = [re.sub(r"[^=\s]*/(?=[^/\s])", "", word) for word in arguments]
    token = _command.set(shlex.join(["legid", *words]))
    try:
        yield
    finally:
        _command.reset(token)


def command_line() -> str:
    """The command line as typed; empty where a script called."""
    return _command.get()


def warn(text: str) -> None:
    """A line that a person must see, on stderr."""
    print(f"warning: {printable(text)}", file=sys.stderr)


def note(text: str) -> None:
    """A line on stderr that --quiet leaves out."""
    if _verbosity.get() > QUIET:
        print(printable(text), file=sys.stderr)


def detail(text: str) -> None:
    """A line on stderr for --verbose."""
    if _verbosity.get() >= VERBOSE:
        note(text)


def printable(text: str) -> str:
    """`text` on one line, without characters that steer a terminal: names in files are anybody's."""
    return "".join(c if c.isprintable() else " " if c.isspace() else f"\\x{ord(c):02x}" for c in text)


class PlainOutput:
    """A stream for people, whatever was read from a file: control characters but line ends are spelt out."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Number of characters written to the stream."""
        self._stream.write(text if text.isascii() and text.isprintable() else
                           "\n".join("\t".join(map(printable, line.split("\t"))) for line in text.split("\n")))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class _Lines:
    """Progress where there is no terminal: a line when the work has lasted for a while, and now and then."""

    def __init__(self, label: str) -> None:
        self._label, self._due = label, time.monotonic() + FIRST_LINE_S
        self._muted = sys.stderr.isatty() or _verbosity.get() == QUIET

    def say(self, what: str) -> None:
        if not self._muted and time.monotonic() >= self._due:
            self._due = time.monotonic() + LINE_EVERY_S
            print(f"{self._label}: {what}", file=sys.stderr, flush=True)


def _hidden() -> bool | None:
    """For tqdm's `disable`: None lets it look for a terminal."""
    return True if _verbosity.get() == QUIET else None


def _shown() -> bool:
    """Whether there is a bar: where there is none nothing waits for tqdm."""
    return not _hidden() and sys.stderr.isatty()


def write_text(path: Path | str, text: str) -> None:
    """Write a text file as `daq.files` does: whole or not at all, never over a run. Raises `InputError`."""
    write_file(path, text.encode())


def write_json(path: Path | str, document: Any) -> None:
    """Write `document` as indented JSON; a number that is not finite becomes null."""
    import msgspec

    write_text(path, msgspec.json.format(msgspec.json.encode(document), indent=2).decode() + "\n")


def make_directory(path: Path) -> None:
    """Make `path` with its parents. Raises `InputError`."""
    with input_errors(path, "give a place that can be written"):
        path.mkdir(parents=True, exist_ok=True)


def progress(items: Iterable[T], label: str, total: int | None = None, unit: str = "it") -> Iterator[T]:
    """`items` behind a progress bar on a terminal, else with a line now and then on stderr."""
    lines, total = _Lines(label), len(items) if total is None and isinstance(items, Sized) else total
    if _shown():
        from tqdm import tqdm

        items = tqdm(items, desc=label, total=total, unit=unit, leave=False)
    for k, item in enumerate(items):
        lines.say(f"{k} of {total} {unit}s" if total else f"{k} {unit}s")
        yield item


@contextmanager
def progress_to(label: str) -> Iterator[Callable[[float, float], None]]:
    """A function (done, total), both in seconds, that moves a progress bar on a terminal, else a line now and then."""
    from tqdm import tqdm

    lines = _Lines(label)
    with tqdm(desc=label, total=1.0, leave=False, disable=_hidden(),
              bar_format="{desc} {percentage:3.0f}%|{bar}| {n:.0f}/{total:.0f} s") as bar:
        def show(done: float, total: float) -> None:
            bar.total = total
            bar.update(done - bar.n)
            lines.say(f"{done:.0f} of {total:.0f} s")

        yield show


@contextmanager
def stages(label: str) -> Iterator[Callable[[str, float], None]]:
    """A function (stage, fraction done) that names the stage and moves a progress bar on a terminal, else a line now
    and then."""
    from tqdm import tqdm

    lines = _Lines(label)
    with tqdm(desc=label, total=1.0, leave=False, disable=_hidden(),
              bar_format="{desc} {percentage:3.0f}%|{bar}| {elapsed}") as bar:
        def show(stage: str, fraction: float) -> None:
            bar.set_description_str(f"{label}: {stage}")
            bar.update(fraction - bar.n)
            lines.say(f"{stage}, {100 * fraction:.0f} %")

        yield show


@contextmanager
def work_bar(label: str, total: int, unit: str) -> Iterator[Callable[[int, str], None]]:
    """A function (pieces done, what they were) that moves a bar with the time left.

    On a terminal a bar; otherwise a line on stderr now and then, for logs of long studies.
    """
    from tqdm import tqdm

    lines, started = _Lines(label), time.monotonic()
    finished = 0
    with tqdm(desc=label, total=total, unit=unit, leave=False, disable=_hidden(), smoothing=0.05) as bar:
        def show(count: int, what: str) -> None:
            nonlocal finished
            finished += count
            bar.set_postfix_str(what, refresh=False)
            bar.update(count)
            left = (time.monotonic() - started) / max(finished, 1) * (total - finished)
            lines.say(f"{finished} of {total} {unit}s, about {left:.0f} s left ({what})")

        yield show


@contextmanager
def busy(label: str) -> Iterator[None]:
    """`label` with the seconds counting up, for work that cannot tell how far it is."""
    done, lines, started = threading.Event(), _Lines(label), time.monotonic()
    with ExitStack() as stack:
        bar = None
        if _shown():
            from tqdm import tqdm

            bar = stack.enter_context(tqdm(desc=label, bar_format="{desc} ... {elapsed}", leave=False))

        def tick() -> None:
            while not done.wait(0.5):
                if bar is not None:
                    bar.refresh()
                lines.say(f"{time.monotonic() - started:.0f} s so far")

        ticker = threading.Thread(target=tick, name="progress", daemon=True)
        ticker.start()
        try:
            yield
        finally:
            done.set()
            ticker.join()


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]], right: Collection[int] = ()) -> str:
    """Columns lined up for a terminal; those numbered in `right` on their right edge."""
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]

    def line(cells: Sequence[str]) -> str:
        return "  ".join(c.rjust(w) if i in right else c.ljust(w)
                         for i, (c, w) in enumerate(zip(cells, widths))).rstrip()

    return "\n".join([line(header), line(["-" * w for w in widths]), *map(line, rows)])
