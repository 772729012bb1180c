"""Text tables of any dialect: separator, decimal comma, lines before the header, a line of units, blank cells.

The dialect is the one under which most cells are numbers. That covers what spreadsheets, LabVIEW and PlotJuggler write
(`__time`, then one column a signal, blank where a signal has no sample at that time).
"""

from __future__ import annotations

import csv
import gzip
import math
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from daq import FloatArray, InputError, read_bytes
from experiments.exchange.imported import ImportedFile, Table, Wrong
from experiments.exchange.text_time import read_times
from experiments.exchange.units import UNITS, plain_unit

SEPARATORS = (",", ";", "\t", "|", " ")
SNIFFED_LINES, MOST_COLUMNS = 200, 4096
MOST_WRONG = 0.05
"""Share of rows that may hold a word where a number belongs; a column with more is one of words."""
BLANK = {"", "nan", "na", "n/a", "null", "none", "-"}
LEAST_SINGLE = 20
"""Rows of a file of one column, at least."""
NAME_LABELS, UNIT_LABELS = ("channel name", "channel", "name", "signal", "kanal"), ("unit", "units", "einheit")
"""Words in front of a channel's name and unit, in the place of its times: the header of some loggers."""
_UNIT_WORDS = {unit for known in UNITS.values() for unit in known}


class Dialect(NamedTuple):
    separator: str
    decimal: str
    first: int
    """Line of the first row of numbers, from 0."""
    cells: int


def read_delimited(path: Path) -> ImportedFile:
    """The table in a text file; columns of words are left out, and rows with a wrong cell named.

    Raises `InputError`.
    """
    lines = _lines(path)
    dialect = _sniff(lines)
    if dialect is None:
        raise InputError(str(path), "holds no table of numbers",
                         f"give a text file with a header line, at most {MOST_COLUMNS} columns and one row a sample")
    names = _names(lines, dialect)
    columns: list[list[float]] = [[] for _ in names]
    bad: dict[int, list[Wrong]] = defaultdict(list)
    rows, long = list[list[str]](), list[Wrong]()
    for number, line in enumerate(lines[dialect.first:], dialect.first + 1):
        if not line.strip():
            continue
        cells = _split(line, dialect.separator)
        if len(cells) > len(names) and any(c.strip() for c in cells[len(names):]):
            long.append(Wrong(f"line {number}", "", f"has {len(cells)} cells, the lines before {len(names)}"))
            continue
        rows.append(cells)
        for k in range(len(names)):
            value = _number(cells[k], dialect.decimal) if k < len(cells) else math.nan
            if value is None:
                bad[k].append(Wrong(f"line {number}", names[k], f"holds {cells[k].strip()[:40]!r}"))
                value = math.nan
            columns[k].append(value)
    most = MOST_WRONG * len(rows)
    if len(long) > most:
        raise InputError(f"{path}, {long[0].place}", long[0].why, "fix or cut the line")
    for k in [k for k, cells in bad.items() if len(cells) > most]:
        times = read_times([cells[k] if k < len(cells) else "" for cells in rows])
        if times is not None:
            columns[k], bad[k] = times.tolist(), []
    text = {k: f"{cells[0].why} in {cells[0].place}" for k, cells in bad.items() if len(cells) > most}
    kept: dict[str, FloatArray] = {name: np.array(columns[k]) for k, name in enumerate(names) if k not in text}
    wrong = tuple([*long, *(one for k, cells in bad.items() if k not in text for one in cells)])
    return ImportedFile(path.name, (Table(kept),), left_out={names[k]: what for k, what in text.items()}, wrong=wrong)


def _lines(path: Path) -> list[str]:
    """Lines of the file, unpacked. Raises `OSError` and what gzip raises."""
    data = read_bytes(path)
    if path.suffix == ".gz":
        data = gzip.decompress(data)
    for encoding in ("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig", "cp1252", "latin-1"):
        try:
            return data.decode(encoding).replace("\r\n", "\n").replace("\r", "\n").split("\n")
        except UnicodeDecodeError:
            continue
    return []


def _split(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    return next(csv.reader([line], delimiter=separator, skipinitialspace=True))


def _number(cell: str, decimal: str) -> float | None:
    """The number, NaN for a blank, None for anything else."""
    text = cell.strip()
    if text.lower() in BLANK:
        return math.nan
    if decimal == ",":
        if "." in text:
            return None
        text = text.replace(",", ".")
    try:
        value = float(text.replace("_", "x"))
    except ValueError:
        return None
    return value if math.isfinite(value) else math.nan


def _sniff(lines: list[str]) -> Dialect | None:
    """The dialect with most numbers in the first lines."""
    found = [block for separator in SEPARATORS for decimal in ".," if decimal != separator
             and (block := _block(lines[:SNIFFED_LINES], separator, decimal)) is not None]
    return max(found, key=lambda block: block[1], default=(None, 0))[0]


def _block(lines: list[str], separator: str, decimal: str) -> tuple[Dialect, int] | None:
    """Where rows of numbers begin that go on to the end, and how many numbers they hold."""
    rows: list[tuple[int, list[float | None]]] = []
    for k, line in enumerate(lines):
        if line.strip():
            try:
                cells = _split(line, separator)
                if len(cells) > MOST_COLUMNS:
                    return None
                rows.append((k, [_number(cell, decimal) for cell in cells]))
            except csv.Error:
                return None
    numbers = [sum(value is not None and math.isfinite(value) for value in row) for _, row in rows]
    begin = len(rows)
    width = len(rows[-1][1]) if rows else 0
    while begin > 0 and numbers[begin - 1] >= 1 and len(rows[begin - 1][1]) >= width \
            and sum(value is None for value in rows[begin - 1][1]) <= width // 2:
        begin -= 1
    if len(rows) - begin < (2 if width > 1 else LEAST_SINGLE):
        return None
    return Dialect(separator, decimal, rows[begin][0], width), sum(numbers[begin:])


def _names(lines: list[str], dialect: Dialect) -> list[str]:
    """Names of the columns: the last line with enough words before the numbers, a line of units put behind them."""
    heads = []
    for line in lines[: dialect.first]:
        cells = [cell.strip() for cell in _split(line.lstrip("#% "), dialect.separator)]
        if len(cells) >= dialect.cells:
            heads.append(cells[: dialect.cells])
    plain = [f"column {k + 1}" for k in range(dialect.cells)]
    if not heads:
        return plain
    names = _labelled(heads) or heads[-1]
    if len(heads) > 1 and all(_bare(cell) in _UNIT_WORDS or not cell for cell in names):
        names = [f"{name} [{_bare(unit)}]" if unit else name for name, unit in zip(heads[-2], names)]
    out: dict[str, None] = {}
    for name, number in zip(names, plain):
        name = name or number
        name = name if name not in out else f"{name} ({number})"
        while name in out:
            name += "'"
        out[name] = None
    return list(out)


def _labelled(heads: list[list[str]]) -> list[str]:
    """Names of a header in which each channel's name and unit have a label in front, in the column of its times; empty
    for any other header."""
    def behind(labels: tuple[str, ...]) -> dict[int, str]:
        line = next((head for head in reversed(heads) if head[0].lower() in labels), [])
        return {k + 1: line[k + 1] for k, cell in enumerate(line[:-1]) if cell.lower() in labels}

    names, units = behind(NAME_LABELS), behind(UNIT_LABELS)
    if not names:
        return []
    out = list(heads[-1])
    for k, name in names.items():
        out[k - 1] = f"{name} time"
        out[k] = f"{name} [{_bare(units[k])}]" if units.get(k) else name
    return out


def _bare(cell: str) -> str:
    return plain_unit(cell.strip("[](){} "))
