"""Other programs' files are read in a child process with bounds of memory and time.

A file of a hundred bytes can declare an array of 20 GB, and readers written in C can crash. Neither may take the
memory of a computer that records, nor end legid. What comes back are numbers and names, not Python objects.
"""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import NamedTuple, NoReturn

import msgspec
import numpy as np
from msgspec import Struct

from daq import InputError
from experiments.exchange.imported import ImportedFile, Table, Wrong

BASE_BYTES, BYTES_PER_BYTE = 700 << 20, 20
"""A reader may take so much memory, and so many times its file's size more."""
BASE_S, BYTES_PER_S = 6.0, 1 << 20
"""It may take so much time of a processor, and a second more for so many bytes of its file."""
WAIT_RATIO = 4.0
"""By the clock it may take so many times longer: on a busy computer, or waiting for a disk."""
MOST_COLUMNS, MOST_VALUES = 4096, 1 << 25
MOST_WRONG = 1 << 16
"""Wrong cells that are handed on; who tells a person names a few."""


class _Table(Struct):
    names: list[str]
    rows: int
    timed: bool


class _Head(Struct):
    """What comes before the numbers."""

    name: str = ""
    tables: list[_Table] = []
    facts: dict[str, str] = {}
    left_out: dict[str, str] = {}
    wrong: list[tuple[str, str, str]] = []
    refusal: tuple[str, str, str] | None = None
    """The parts of an `InputError`."""


class Reader(NamedTuple):
    """The function that reads one kind of file, and what it needs."""

    read: Callable[[Path], ImportedFile]
    kind: str = ""
    """With its article; empty for the ending of the file's name."""
    library: str = "json"
    """Module that it needs, loaded before the child starts: once, for any number of files."""


def read_bounded(reader: Reader, path: Path, size: int) -> ImportedFile:
    """The file at `path` of `size` bytes, by a child process. Raises `InputError`, beyond the bounds too."""
    with suppress(Exception):  # what is missing or broken, the reader says
        import_module(reader.library)
    most_bytes, most_s = BASE_BYTES + BYTES_PER_BYTE * size, BASE_S + size / BYTES_PER_S
    ours, theirs = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads: the child starts none and waits for none
        child = os.fork()
    if child == 0:
        os.close(ours)
        _read_and_send(reader, path, theirs, most_bytes, most_s)
    os.close(theirs)
    try:
        data = _received(ours, str(path), most_bytes, time.monotonic() + WAIT_RATIO * most_s)
    except BaseException:
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        raise
    finally:
        os.close(ours)
    _, status = os.waitpid(child, 0)
    if not data or os.WIFSIGNALED(status):
        raise _killed(str(path), os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0, most_s)
    return _unpacked(data, str(path))


# -- in the child ------------------------------------------------------------------------------------------------------


def _read_and_send(reader: Reader, path: Path, to: int, most_bytes: int, most_s: float) -> NoReturn:
    """Never returns: nothing of the parent's is run by its child."""
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        _limit(most_bytes, most_s)
        os.dup2(os.open(os.devnull, os.O_RDWR), 0)
        os.dup2(0, 1)
        os.dup2(0, 2)  # libraries in C complain there, in more than a line
        with open(to, "wb") as pipe:
            for part in _attempt(reader, path, most_bytes):
                pipe.write(part)
    except BaseException:  # the parent sees that nothing came, or not all
        os._exit(1)
    os._exit(0)


def _limit(most_bytes: int, most_s: float) -> None:
    """Bounds of this process from now on: memory beyond what it has, time of a processor, no core."""
    with suppress(OSError, ValueError):
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        _lower(resource.RLIMIT_AS, used + most_bytes)
    seconds = round(most_s)
    for kind, bound in ((resource.RLIMIT_CPU, seconds), (resource.RLIMIT_CORE, 0), (resource.RLIMIT_FSIZE, most_bytes)):
        with suppress(OSError, ValueError):
            _lower(kind, bound)


def _lower(kind: int, bound: int) -> None:
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (bound if hard == resource.RLIM_INFINITY else min(bound, hard), hard))


def _attempt(reader: Reader, path: Path, most_bytes: int) -> list[bytes]:
    """The file's content for the pipe, or the refusal."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _packed(_checked(reader.read(path), path))
    except InputError as error:
        refused = error
    except MemoryError:
        refused = InputError(str(path), f"needs more than {most_bytes / 1e6:.0f} MB of memory to be read",
                             "give a smaller part of it")
    except RecursionError:
        refused = InputError(str(path), "is nested too deep", "give a table, or an array for each signal")
    except Exception as error:  # readers raise what their format makes of a damaged file
        kind = reader.kind or path.suffix
        refused = InputError(str(path), f"cannot be read as {kind} ({type(error).__name__}: {error})",
                             "give a whole file")
    return [_line(_Head(refusal=(refused.where, refused.what, refused.remedy)))]


def _line(head: _Head) -> bytes:
    """JSON in a line whose length is a multiple of 8: the numbers behind it can be used where they are."""
    text = json.dumps(msgspec.to_builtins(head)).encode()  # names of any characters, halves of some too
    return text + b" " * (-(len(text) + 1) % 8) + b"\n"


def _checked(imported: ImportedFile, path: Path) -> ImportedFile:
    columns = len(imported.names) + len(imported.left_out)
    if columns > MOST_COLUMNS:
        raise InputError(str(path), f"has {columns} columns, {MOST_COLUMNS} are read",
                         "give a file with the signals alone")
    values = sum(column.size for table in imported.tables for column in table.columns.values())
    if values > MOST_VALUES:
        raise InputError(str(path), f"holds {values:.3g} numbers, {MOST_VALUES:.3g} are read",
                         "give a smaller part of it")
    return imported


def _packed(imported: ImportedFile) -> list[bytes]:
    """A line of JSON, and the numbers behind it."""
    head = _Head(imported.name, [_Table(list(t.columns), _rows(t), t.time_s is not None) for t in imported.tables],
                 dict(imported.facts), dict(imported.left_out),
                 [(w.place, w.column, w.why) for w in imported.wrong[:MOST_WRONG]])
    arrays = [array for table in imported.tables for array in
              (*table.columns.values(), *(() if table.time_s is None else (table.time_s,)))]
    return [_line(head), *(np.ascontiguousarray(a, dtype="<f8").tobytes() for a in arrays)]


def _rows(table: Table) -> int:
    return next((column.size for column in table.columns.values()), 0)


# -- in the parent -----------------------------------------------------------------------------------------------------


def _received(ours: int, where: str, most_bytes: int, deadline_s: float) -> bytearray:
    """Everything that the child sends until it ends."""
    data = bytearray()
    while True:
        ready, _, _ = select.select([ours], [], [], max(deadline_s - time.monotonic(), 0.0))
        if not ready:
            raise InputError(where, "takes too long to be read", "give a smaller part of it, or close other programs")
        piece = os.read(ours, 1 << 20)
        if not piece:
            return data
        data += piece
        if len(data) > most_bytes:
            raise InputError(where, f"holds more than {most_bytes / 1e6:.0f} MB of numbers",
                             "give a smaller part of it")


def _killed(where: str, number: int, most_s: float) -> InputError:
    if number in (signal.SIGXCPU, signal.SIGKILL):
        return InputError(where, f"takes more than {most_s:.0f} s of a processor, or too much memory, to be read",
                          "give a smaller part of it")
    how = f"its reader crashed with signal {number}" if number else "its reader ended without a word"
    return InputError(where, f"cannot be read: {how}", "give a whole file")


def _unpacked(data: bytearray, where: str) -> ImportedFile:
    """What the child sent. Raises `InputError` for its refusal, and for anything that is not what it should send."""
    try:
        at = data.index(b"\n") + 1
        found = msgspec.convert(json.loads(data[:at]), _Head)
        if found.refusal is not None:
            raise InputError(*found.refusal)
        tables = []
        for table in found.tables:
            arrays = []
            for _ in range(len(table.names) + table.timed):
                arrays.append(np.frombuffer(data, "<f8", table.rows, at))
                at += 8 * table.rows
            columns = dict(zip(table.names, arrays))
            tables.append(Table(columns, arrays[-1] if table.timed else None))
        if at != len(data):
            raise ValueError
    except (ValueError, msgspec.MsgspecError):
        raise InputError(where, "cannot be read: its reader ended early", "give a whole file") from None
    return ImportedFile(found.name, tuple(tables), found.facts, found.left_out,
                        tuple(Wrong(*one) for one in found.wrong))
