"""Samples of a file of any program, as it calls them: tables of columns that share their rows."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from daq import FloatArray, InputError


class Table(NamedTuple):
    """Columns of one length."""

    columns: Mapping[str, FloatArray]
    """The file's name of a column -> (n,), NaN where there is no sample."""
    time_s: FloatArray | None = None
    """(n,) times that the format itself gives, from the file's first [s]; None where a column holds the time."""


class Wrong(NamedTuple):
    """A cell, or a row, that is not used."""

    place: str
    """`line 61` of a text file, `row 60` of samples; both count from 1."""
    column: str
    """Empty for the whole row."""
    why: str


@dataclass(frozen=True)
class ImportedFile:
    """One file."""

    name: str
    tables: tuple[Table, ...]
    facts: Mapping[str, str] = field(default_factory=dict)
    """What the file says of itself: the rate and clock of an own export."""
    left_out: Mapping[str, str] = field(default_factory=dict)
    """Columns that are no numbers -> what they hold instead, and where."""
    wrong: tuple[Wrong, ...] = ()
    """Cells and rows that were set aside, in the file's order."""

    @property
    def names(self) -> list[str]:
        """Names of all columns, in the file's order."""
        return [name for table in self.tables for name in table.columns]

    def table_of(self, column: str) -> Table:
        """The table that holds `column`. Raises `InputError` naming columns that are there."""
        for table in self.tables:
            if column in table.columns:
                return table
        known = next((name for name in (column, column.partition("{")[0]) if name in self.left_out), None)
        if known is not None:
            what, save, how = self.left_out[known].partition(": save ")
            raise InputError(self.name, f"column {known!r} {what}",
                             f"save {how}" if save else "correct that cell, or empty it")
        close = difflib.get_close_matches(column, self.names, 1, 0.6)
        some = ", ".join(self.names[:12]) + (", ..." if len(self.names) > 12 else "")
        raise InputError(self.name, f"has no column {column!r}", f"did you mean {close[0]!r}?" if close
                         else f"it has {some}" if some else "it holds no column of numbers")

    def values(self, column: str) -> FloatArray:
        """(n,) numbers of `column`. Raises `InputError` as `table_of` does."""
        return self.table_of(column).columns[column]


def by_length(columns: Mapping[str, FloatArray]) -> tuple[Table, ...]:
    """Columns (n,) grouped into tables, the longest first."""
    lengths = sorted({values.size for values in columns.values()}, reverse=True)
    return tuple(Table({name: values for name, values in columns.items() if values.size == n}) for n in lengths)


def needs(where: object, package: str, extra: str) -> InputError:
    """The error for a kind of file whose `package` is not installed."""
    return InputError(str(where), f"needs the package {package}", f'install it: pip install "legid[{extra}]"')
