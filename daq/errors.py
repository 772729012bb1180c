"""Errors about unusable input and failed work, one line each."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

LONGEST = 600


class InputError(Exception):
    """Bad input: one line naming the file, the place and the remedy. The command line exits with 2."""

    def __init__(self, where: str, what: str, remedy: str = "") -> None:
        where, what, remedy = (" ".join((text if len(text) <= LONGEST else f"{text[:LONGEST]} ...").splitlines())
                               for text in (where, what, remedy))  # a file's own words may be of any length
        self.where, self.what, self.remedy = where, what, remedy
        line = f"{where}: {what}" if where else what
        super().__init__(f"{line}; {remedy}" if remedy else line)

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        """Its parts: a worker process hands it back by pickle."""
        return type(self), (self.where, self.what, self.remedy)


@contextmanager
def input_errors(path: Path | str, remedy: str) -> Iterator[None]:
    """Raises `InputError` with the words of the system and this remedy where the file at `path` is not to be had."""
    try:
        yield
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), remedy) from None


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """"; did you mean ...?" for the known word that is spelt most like `word`; empty where none is."""
    close = difflib.get_close_matches(word, list(known), 1, 0.6)
    return f"; did you mean {close[0]}?" if close else ""


class WorkError(Exception):
    """The work could not be done on this data or device (a limit tripped, no convergence). Exits with 1."""
