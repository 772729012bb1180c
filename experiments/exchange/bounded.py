"""Other programs' files are read in a child process with bounds of memory and time.

What comes back are numbers and names, not Python objects.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from daq import FloatArray, InputError
from experiments.bounded_child import Bounds, answer_of_child, ended_early
from experiments.exchange.imported import ImportedFile

BASE_BYTES, BYTES_PER_BYTE = 700 << 20, 20
"""A reader may take so much memory, and so many times its file's size more."""
BASE_S, BYTES_PER_S = 6.0, 1 << 20
"""It may take so much time of a processor, and a second more for so many bytes of its file."""
MOST_COLUMNS, MOST_VALUES = 4096, 1 << 25
MOST_WRONG = 1 << 16
"""Wrong cells that are handed on; who tells a person names a few."""


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
    bounds = Bounds(str(path), reader.kind or path.suffix, BASE_BYTES + BYTES_PER_BYTE * size,
                    BASE_S + size / BYTES_PER_S)
    data = answer_of_child(lambda: _packed(_checked(reader.read(path), path)), bounds)
    return _unpacked(data, str(path))


# -- in the child ------------------------------------------------------------------------------------------------------


def _checked(imported: ImportedFile, path: Path) -> ImportedFile:
    columns = len(imported.names) + len(imported.left_out)
    if columns > MOST_COLUMNS:
        raise InputError(str(path), f"has {columns} columns, {MOST_COLUMNS} are read",
                         "give a file with the signals alone")
    values = sum(column.size for table in imported.tables for column in table.columns.values())
    if values > MOST_VALUES:
        raise InputError(str(path), f"holds {values:.3g} numbers, {MOST_VALUES:.3g} are read",
                         "give a smaller part of it")
    return replace(imported, wrong=imported.wrong[:MOST_WRONG])


def _packed(imported: ImportedFile) -> list[bytes]:
    """A line of JSON with the length of each array, and the arrays' numbers behind it."""
    arrays: list[bytes] = []

    def aside(array: FloatArray) -> int:
        arrays.append(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return array.size

    head = json.dumps(msgspec.to_builtins(imported, enc_hook=aside)).encode()  # names of any characters, halves of some
    return [head + b" " * (-(len(head) + 1) % 8) + b"\n", *arrays]  # numbers can be used where they are


# -- in the parent -----------------------------------------------------------------------------------------------------


def _unpacked(data: bytearray, where: str) -> ImportedFile:
    """What the child sent. Raises `InputError` for anything that is not what it should send."""
    try:
        at = data.index(b"\n") + 1
        head = json.loads(data[:at])

        def numbers(_: type, size: int) -> FloatArray:
            nonlocal at
            at += 8 * size
            return np.frombuffer(data, "<f8", size, at - 8 * size)

        file = msgspec.convert(head, ImportedFile, dec_hook=numbers)
        if at != len(data):
            raise ValueError
    except (ValueError, msgspec.MsgspecError):
        raise ended_early(where) from None
    return file
