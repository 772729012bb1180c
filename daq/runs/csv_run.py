"""A run as CSV: read with every fault named by line and column, written so that it reads back the same."""

from __future__ import annotations

import csv
import difflib
import gzip
import io
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite, isinf
from pathlib import Path

import numpy as np

from daq.dataset import Dataset, FloatArray
from daq.errors import InputError, input_errors
from daq.files import read_bytes, write_file
from daq.findings import Flag
from daq.rig import Rig
from daq.runs.columns import is_contract_column, known, missing
from daq.runs.counter import restart_remedy, unwrapped_counter

MIN_SAMPLES = 50
CLOCK_BOUND = "clock_bound_s"
MOST, MOST_OF_OTHERS = 1e12, 1e100
"""Largest magnitude of a reading, and of what stands in a column of the user's own (counts, times since 1970 in ns)."""
LEAST_STEP_S = 1e-9
MOST_COLUMNS = 4096
_GZIP_MAGIC = b"\x1f\x8b"
SUFFIXES = (".csv", ".csv.gz")
UNPACKED_BYTES, UNPACKED_RATIO = 16 << 20, 30
"""A packed file may unpack to so much, and so many times its own size more: numbers pack to a third or a tenth."""


@dataclass(frozen=True)
class RawTable:
    """The samples of one file as they stand there: nothing aligned, nothing filtered."""

    name: str
    """The file's name."""
    time_s: FloatArray
    """(n,) strictly increasing sample times [s]."""
    columns: Mapping[str, FloatArray]
    """Every numeric column but the time, (n,) each, finite."""
    ignored: tuple[str, ...] = ()
    """Columns of the user's own that hold anything but numbers, left out."""
    flags: tuple[Flag, ...] = ()
    """What was corrected in its times."""


def read_csv(path: Path | str, rig: Rig | None = None, min_samples: int = MIN_SAMPLES) -> RawTable:
    """Samples of a `.csv` or `.csv.gz`.

    With a `rig` its mechanism's required columns are checked as well; without one only `time_s` is
    required. Of the user's own columns those that hold anything but numbers are left out and
    named in `ignored`. Raises `InputError` naming file, line and column.
    """
    path = Path(path)
    header, body = _split(path)
    names = _header_names(path, header)
    _check_columns(path, names, rig)
    table, kept = _parse(path, names, body, rig)
    if table.shape[0] < min_samples:
        raise InputError(str(path), f"holds {table.shape[0]} samples, at least {min_samples} are needed",
                         "record for longer")
    columns = {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(kept)}
    time_s, flags = columns.pop("time_s"), tuple[Flag, ...]()
    goes_on = unwrapped_counter(time_s)
    if goes_on is not None:
        time_s, flags = goes_on.time, (goes_on.flag("time_s"),)
    _check_time(path, time_s, names, body)
    return RawTable(path.name, time_s, columns, tuple(name for name in names if name not in kept), flags)


def write_csv(dataset: Dataset, path: Path | str, replace: bool = False) -> int:
    """Write `dataset` as `.csv` (or `.csv.gz`) by the contract; returns the number of rows.

    Rows with a gap in any column are left out, so that the hole shows in `time_s`; a column that has no
    sample at all is left out whole. Values keep 12 significant digits, times a nanosecond. What the recorder's
    clocks leave open goes into a column of its own, `clock_bound_s`, which fits allow for. Raises `InputError`,
    for another run that is there already too, unless `replace`, and where fewer rows than a run needs have no gap.
    """
    path = Path(path)
    names = [name for name, values in dataset.columns.items() if np.isfinite(values).any()]
    rows = ~dataset.gap(names)
    columns = [dataset.time_s[rows], *(dataset[name][rows] for name in names)]
    if dataset.clock_bound_s > 0.0:
        names.append(CLOCK_BOUND)
        columns.append(np.full(columns[0].shape, dataset.clock_bound_s))
    if columns[0].size < MIN_SAMPLES:
        raise InputError(dataset.name, f"has {columns[0].size} rows without a gap in {', '.join(names)}, at least "
                                       f"{MIN_SAMPLES} are needed", "leave out a column with gaps, or record again")
    table = np.column_stack(columns)
    text = io.StringIO()
    np.savetxt(text, table, fmt=["%.9f"] + ["%.12g"] * len(names), delimiter=",",
               header=",".join(["time_s", *names]), comments="")
    data = text.getvalue().encode()
    # A fixed mtime and no name: the same run gives the same bytes.
    write_file(path, gzip.compress(data, 6, mtime=0) if path.suffix == ".gz" else data, changed=replace)
    return int(rows.sum())


def _split(path: Path) -> tuple[str, str]:
    """Header line and the rest, as text with plain newlines."""
    where = str(path)
    with input_errors(path, "give a readable CSV file"):
        data = read_bytes(path)
    if not data:
        raise InputError(where, "is empty", "give a file with a header line and samples")
    if path.suffix == ".gz" or data.startswith(_GZIP_MAGIC):
        try:
            most = UNPACKED_BYTES + UNPACKED_RATIO * len(data)
            with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
                data = file.read(most + 1)
            if len(data) > most:
                raise InputError(where, f"unpacks to more than {UNPACKED_RATIO} times its size", "unpack it first")
        except (OSError, EOFError, zlib.error) as error:
            raise InputError(where, f"cannot be unpacked as gzip ({error})", "copy or pack the file again") from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{where}, line {line}", "is not UTF-8 text", "save the file as UTF-8 CSV") from None
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    header, _, body = text.partition("\n")
    if not header.strip():
        raise InputError(f"{where}, line 1", "has no header", "name the columns on the first line")
    return header, body


def _header_names(path: Path, header: str) -> list[str]:
    where = f"{path}, line 1"
    names = [cell.strip() for cell in _cells(where, header)]
    if len(names) == 1 and any(mark in header for mark in ";\t"):
        raise InputError(where, "is not comma separated: it is another program's file",
                         f"run: legid import {path} --map columns.toml --guess")
    if len(names) > MOST_COLUMNS:
        raise InputError(where, f"names {len(names)} columns, {MOST_COLUMNS} are read", "keep those of the run alone")
    for name in names:
        if not name:
            raise InputError(where, "has an unnamed column", "name every column")
        if names.count(name) > 1:
            raise InputError(where, f"names column {name} twice", "keep one of them")
    return names


def _check_columns(path: Path, names: list[str], rig: Rig | None) -> None:
    lacking = missing(rig, names) if rig is not None else None
    if rig is None and "time_s" not in names:
        column, remedy = "time_s", "add the sample time in seconds"
    elif lacking is not None:
        column, remedy = lacking
    else:
        return
    if not any(map(is_contract_column, names)):
        raise InputError(f"{path}, line 1", f"column {column} is missing, and no name is a run's: it is another "
                         "program's file", f"run: legid import {path} --map columns.toml --guess")
    close = difflib.get_close_matches(column, [n for n in names if n not in known(rig, names)], 1, 0.6)
    if close:
        remedy = f"rename {close[0]} to {column} if that is what it holds, in SI units"
    raise InputError(f"{path}, line 1", f"column {column} is missing", remedy)


def _parse(path: Path, names: list[str], body: str, rig: Rig | None) -> tuple[FloatArray, list[str]]:
    """Numbers (rows, columns kept) and the names of the columns kept."""
    if not body.strip():
        return np.empty((0, len(names))), names
    try:
        table = _numbers(body, None)
        if table.shape[1] == len(names) and (np.abs(table) <= MOST).all():  # NaN is not
            return table, names
    except ValueError:
        pass  # the slow path below says where
    unusable = _find_fault(path, names, body, known(rig, names))
    keep = [i for i, name in enumerate(names) if name not in unusable]
    return _numbers(body, keep), [names[i] for i in keep]


def _numbers(body: str, columns: list[int] | None) -> FloatArray:
    return np.loadtxt(io.StringIO(body), delimiter=",", comments=None, quotechar='"', ndmin=2, usecols=columns)


def _find_fault(path: Path, names: list[str], body: str, checked: set[str]) -> set[str]:
    """Names of the user's own columns that hold no numbers; raises `InputError` at the first other fault."""
    unusable: set[str] = set()
    for line, cells in _lines(path, body):
        place = f"{path}, line {line}"
        if len(cells) != len(names):
            column = names[len(cells)] if len(cells) < len(names) else names[-1]
            raise InputError(f"{place}, column {column}",
                             f"the line has {len(cells)} cells, the header {len(names)}", "correct or delete the line")
        for name, cell in zip(names, cells):
            fault = _fault(cell, MOST if name in checked else MOST_OF_OTHERS)
            if fault and name in checked:
                raise InputError(f"{place}, column {name}", fault, "give a number, or cut the line")
            if fault:
                unusable.add(name)
    return unusable


def _lines(path: Path, body: str) -> Iterator[tuple[int, list[str]]]:
    """Line number in the file and cells of every line that is not blank."""
    return ((number, _cells(f"{path}, line {number}", line))
            for number, line in enumerate(io.StringIO(body), 2) if line.strip())


def _cells(where: str, line: str) -> list[str]:
    try:
        return next(csv.reader([line.rstrip("\n")], strict=True))
    except csv.Error as error:
        raise InputError(where, f"cannot be read as CSV ({error})", "correct or delete the line") from None


def _fault(cell: str, most: float) -> str:
    text = cell.strip()
    if not text:
        return "the cell is empty"
    try:
        value = float(text.replace("_", "x"))
    except ValueError:
        return f"{text[:24]!r} is not a number"
    if abs(value) <= most:
        return ""
    if isfinite(value):
        return f"{text[:24]} is larger than any reading"
    return "the value is infinite" if isinf(value) else "the value is NaN"


def _check_time(path: Path, time_s: FloatArray, names: list[str], body: str) -> None:
    bad = np.flatnonzero(np.diff(time_s) < LEAST_STEP_S)
    if bad.size == 0:
        return
    column = names.index("time_s")
    for (_, before), (line, cells) in pairwise(_lines(path, body)):
        t0, t1 = before[column].strip(), cells[column].strip()
        if float(t1) - float(t0) < LEAST_STEP_S:
            back = float(t1) < float(t0)
            fault = f"time runs backwards ({t0} then {t1})" if back else f"time repeats ({t1})"
            raise InputError(f"{path}, line {line}, column time_s", fault, restart_remedy(time_s, f"line {line}") or
                             "sort the rows by time and keep one row a sample")
