"""COLUMNS.toml: which column of a file is which of the contract, and in what unit.

The same table stands in a rig.toml as `[columns]`. value = sign * scale * unit * (reading - minus) + offset, at the
time of the reading less its delay.
"""

from __future__ import annotations

import re
import tomllib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from zlib import crc32

import msgspec
import numpy as np
from msgspec import structs

from daq import Column, Dataset, Flag, FloatArray, IndexArray, InputError, comment, input_errors, quoted, read_bytes
from daq.runs import MIN_SAMPLES, MOST, is_contract_column, restart_remedy, unwrapped_counter
from daq.timing import TimedColumns, align_channels, own_rate
from experiments.exchange.imported import ImportedFile, Table, Wrong
from experiments.exchange.registers import signed
from experiments.exchange.units import factor, plain_unit

ColumnMap = Mapping[str, Column]
TIME = "time_s"
RAW = ("a", "ma", "lsb", "counts")
"""Units of what stands for a torque, which only its scale makes one."""
MOST_REPEATED = 0.01
"""Share of rows whose time does not increase that is left out in silence."""
MOST_TOLD = 4
"""Wrong rows that are named one by one."""
MOST_BYTES = 1 << 20
"""Of a map of columns."""
ANY = "{*}"
"""In a map, the number of a run in a file of several: one run is made of each."""
EXPRESSION = re.compile(r"\s[-+/]\s|\*")
"""What a name has that is meant as an expression."""
Key = tuple[int, float]


def load_map(path: Path | str) -> dict[str, Column]:
    """The map in a COLUMNS.toml, or in the `[columns]` of a rig file. Raises `InputError` naming file and key."""
    where = str(path)
    try:
        with input_errors(path, "give the map, or let --guess write it"):
            document = tomllib.loads(read_bytes(path, MOST_BYTES).decode("utf-8"))
        return check_map(msgspec.convert(document.get("columns", {}), dict[str, Column]), where)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(where, f"not valid TOML: {error}", "correct that line") from None
    except msgspec.ValidationError as error:
        raise InputError(where, str(error).replace("`$", "`columns"), "see docs/exchange.md") from None


def check_map(columns: dict[str, Column], where: str) -> dict[str, Column]:
    """`columns` as they are. Raises `InputError` for a column or a unit that the contract does not know."""
    if not columns:
        raise InputError(where, "has no [columns]", 'name one by [columns.q2_rad] and name = "..."')
    for name, column in columns.items():
        if not is_contract_column(name):
            raise InputError(f"{where}, columns.{name}", "is no column of a run", "see docs/formats.md, A run as CSV")
        factor(column.unit, name, f"{where}, columns.{name}")
        if not (np.isfinite([column.scale, column.offset, column.delay]).all() and column.scale):
            raise InputError(f"{where}, columns.{name}", "has a scale, offset or delay that is no finite number",
                             "correct it; a scale is not 0")
    return columns


def only_time(found: Mapping[str, Any]) -> dict[str, Any]:
    """The entry of `found` for the time; empty without one."""
    return {TIME: found[TIME]} if TIME in found else {}


def require_scales(columns: ColumnMap, where: str) -> None:
    """Raises `InputError` for a torque in amperes or counts without a scale: every parameter would be wrong by it."""
    lacking = unscaled(columns)
    if lacking is not None:
        name, unit = lacking
        raise InputError(f"{where}, columns.{name}", f"is in {unit} and has no scale",
                         f"give scale, the torque at the joint per {unit}, gear included; or leave unit out if the "
                         "column is in N m already; or, if the joint follows a command that is in the file, take the "
                         "torque out of the map")


def with_scales(columns: ColumnMap, scale: Mapping[str, float]) -> dict[str, Column]:
    """`columns` with the factors `scale`, by column. Raises `InputError` for one of no column."""
    for name in scale:
        if name not in columns:
            raise InputError("scale", f"{name} is no column of the map", f"it has {', '.join(columns)}")
    return {name: structs.replace(column, scale=scale.get(name, column.scale)) for name, column in columns.items()}


def unscaled(columns: ColumnMap) -> tuple[str, str] | None:
    """The first torque in amperes or counts without a scale, and its unit; None where there is none."""
    return next(((name, column.unit) for name, column in columns.items()
                 if name.startswith("tau") and plain_unit(column.unit) in RAW and column.scale == 1.0), None)


def map_text(columns: ColumnMap, notes: Mapping[str, str] | None = None) -> str:
    """The file's text; `notes` are comments by column."""
    blank = Column(name="")
    parts = ["# Which column of a file is which of a run: value = sign * scale * unit * reading + offset, and a",
             "# reading is stamped `delay` seconds late. For legid import --map, or in a rig.toml for all.", ""]
    for name, column in columns.items():
        parts += [f"# {comment(line)}" for line in (notes or {}).get(name, "").splitlines()]
        parts.append(f"[columns.{name}]")
        for key in column.__struct_fields__:
            value = getattr(column, key)
            if key == "name" or value != getattr(blank, key):
                written = quoted(value) if isinstance(value, str) else msgspec.json.encode(value).decode()
                parts.append(f"{key} = {written}")
        parts.append("")
    return "\n".join(parts)


COMMAND = re.compile(r"qd?\d+_cmd_rad(ps)?")
"""Columns that a run can do without: of a controller that one session logged, and another did not."""
MARK = "# Guessed by legid import. Check sum of the lines below, as long as nobody changes them: "


def guess_text(columns: ColumnMap, notes: Mapping[str, str]) -> str:
    """`map_text` with a line by which `is_guess` knows it."""
    text = map_text(columns, notes)
    return f"{MARK}{crc32(text.encode()):08x}\n{text}"


def is_guess(path: Path) -> bool:
    """The file is a map that a guess wrote, and nobody has changed it since."""
    head, _, text = read_bytes(path, MOST_BYTES).partition(b"\n")
    return head == f"{MARK}{crc32(text):08x}".encode()


def applies(imported: ImportedFile, columns: ColumnMap) -> bool:
    """The file has a column that the map names, or the map names an expression."""
    return any(column.name in imported.names or EXPRESSION.search(column.name) for column in columns.values())


def runs_in(imported: ImportedFile, columns: ColumnMap) -> list[tuple[str, dict[str, Column]]]:
    """(ending of its name, map) of every run that the map finds: one, or with `{*}` one for each number."""
    if not any(ANY in column.name for column in columns.values()):
        return [("", dict(columns))]
    numbers = sorted({int(k) for name in imported.names for k in re.findall(r"\{(\d+)\}", name)})
    out = []
    for k in numbers:
        own = {name: structs.replace(column, name=column.name.replace(ANY, f"{{{k}}}"),
                                     minus=column.minus.replace(ANY, f"{{{k}}}")) for name, column in columns.items()}
        if all(column.name in imported.names for column in own.values()):
            out.append((f"-{k:0{len(str(numbers[-1]))}d}", own))
    if not out:
        raise InputError(imported.name, f"has no numbered run that holds all of the map's columns with {ANY}",
                         "name them as legid import shows them")
    return out


def identity(imported: ImportedFile) -> dict[str, Column]:
    """The map of a file that has the contract's own names."""
    return {name: Column(name=name) for name in imported.names if is_contract_column(name)}


def apply_map(imported: ImportedFile, columns: ColumnMap, rate_hz: float | None = None, as_read: bool = False
              ) -> Dataset:
    """The file as a run, on a grid of `rate_hz` (default: that of its slowest signal).

    Columns that come at times of their own, or with delays of their own, are each put on the grid by the rule that
    native runs are; a column of the contract's name that the map does not mention is taken as it is. A file of several
    may lack a command, which is said. A table without times has `rate_hz` rows a second. Raises `InputError` naming
    file and column.
    """
    whole = {**identity(imported), **columns}
    if any(ANY in column.name for column in whole.values()):
        raise InputError(imported.name, f"holds several runs by its map ({ANY})", "import it: legid import writes one "
                         "file a run")
    for column in whole.values():
        if EXPRESSION.search(column.name) and column.name not in (*imported.names, *imported.left_out):
            raise InputError(imported.name, f"has no column {column.name!r}, and a map computes nothing",
                             "compute it before the import, or take one column off another by minus")
    lacks = {name: column.name for name, column in whole.items() if COMMAND.fullmatch(name)
             and column.name not in imported.names and column.name not in imported.left_out}
    whole = {name: column for name, column in whole.items() if name not in lacks}
    channels, wrong, flags = _channels(imported, whole, rate_hz)
    if not channels:
        raise InputError(imported.name, "holds no column that the map names", "correct the map, or run --guess")
    run = align_channels(imported.name, channels, rate_hz or own_rate(channels), as_read)
    if len(run) < MIN_SAMPLES:
        raise InputError(imported.name, f"gives {len(run)} samples, at least {MIN_SAMPLES} are needed",
                         "record for longer, or check the unit of time_s")
    used = {name for column in whole.values() for name in (column.name, column.minus)}
    wrong = [*(one for one in imported.wrong if not one.column or one.column in used), *wrong]
    told = [Flag("rows", f"has no column {column!r}, and so no {name}") for name, column in lacks.items()]
    told += [Flag("rows", _told(wrong))] if wrong else []
    return replace(run, flags=(*flags, *run.flags, *told))


def _told(wrong: Sequence[Wrong]) -> str:
    """Rows that are not used, in few words."""
    rows = [f"{one.place} ({f'{one.column!r} ' if one.column else ''}{one.why})" for one in wrong[:MOST_TOLD]]
    more = f" and {len(wrong) - MOST_TOLD} more" if len(wrong) > MOST_TOLD else ""
    return f"has {len(wrong)} wrong sample{'s' * (len(wrong) != 1)}, left out: {', '.join(rows)}{more}"


def _channels(imported: ImportedFile, columns: ColumnMap,
              rate_hz: float | None) -> tuple[list[TimedColumns], list[Wrong], tuple[Flag, ...]]:
    """Columns in SI units, those of the same times together; times count from the first. The rows left out, and what
    was corrected in the times."""
    groups: dict[Key, dict[str, FloatArray]] = defaultdict(dict)
    clocks: dict[Key, FloatArray] = {}
    wrong: list[Wrong] = []
    flags: dict[str, Flag] = {}
    for name, column in columns.items():
        if name == TIME:
            continue
        table = imported.table_of(column.name)
        key = next(k for k, t in enumerate(imported.tables) if t is table), column.delay
        clock = _clock(imported, table, columns, rate_hz)
        wraps = unwrapped_counter(clock, 1.0)
        if wraps is not None:
            clock, flags[TIME] = wraps.time, wraps.flag(TIME)
        clocks[key] = clock - column.delay
        read = signed(table.columns[column.name], column)
        if column.minus:
            read = read - signed(_on_times_of(table, imported, column.minus), column)
        scale = column.sign * column.scale * factor(column.unit, name, imported.name)
        values = read if (scale, column.offset) == (1.0, 0.0) else scale * read + column.offset
        far = np.flatnonzero(np.abs(values) > MOST)
        wrong += [Wrong(f"row {k + 1}", column.name, f"is {values[k]:.3g}, larger than any reading") for k in far]
        groups[key][name] = np.where(np.abs(values) > MOST, np.nan, values)
    out = []
    for key, group in groups.items():
        rows = _increasing(imported.name, clocks[key])
        late = np.setdiff1d(np.arange(clocks[key].size), rows)
        wrong += [Wrong(f"row {k + 1}", "", "has no time" if not np.isfinite(clocks[key][k]) else
                        "its time is not after the one before") for k in late if key[1] == 0.0]
        for times, names in _sparse({name: values[rows] for name, values in group.items()}, clocks[key][rows]):
            out.append(TimedColumns(times, names))
    return out, wrong, tuple(flags.values())


def _on_times_of(home: Table, imported: ImportedFile, name: str) -> FloatArray:
    """Column `name` at the times of `home`, by straight lines where it has times of its own."""
    table = imported.table_of(name)
    values = table.columns[name]
    if table is home:
        return values
    if table.time_s is None or home.time_s is None:
        raise InputError(imported.name, f"column {name!r} has {values.size} rows, that which it is taken off "
                                       f"{next(iter(home.columns.values())).size}", "save them with one time for all")
    return np.interp(home.time_s, table.time_s, values, left=np.nan, right=np.nan)


def _clock(imported: ImportedFile, table: Table, columns: ColumnMap, rate_hz: float | None) -> FloatArray:
    """The table's times [s]; without any, `rate_hz` rows a second."""
    column = columns.get(TIME)
    if column is None:
        if table.time_s is not None:
            return table.time_s
        if rate_hz is None:
            raise InputError(imported.name, "has no times", 'name the column by [columns.time_s] and name = "...", or '
                                                            "give the samples per second with --rate")
        return np.arange(next(iter(table.columns.values())).size) / rate_hz
    home = imported.table_of(column.name)
    read = home.columns[column.name]
    if home is not table:
        raise InputError(imported.name, f"has {read.size} times in {column.name!r} and "
                                       f"{next(iter(table.columns.values())).size} samples in other columns",
                         "save them with one time for all")
    time_s = column.scale * factor(column.unit, TIME, imported.name) * read + column.offset
    return time_s - time_s[0] if (column.unit, column.scale) != ("", 1.0) else time_s


def _increasing(where: str, time_s: FloatArray) -> IndexArray:
    """Rows whose time is known and later than all before. Raises `InputError` where those are not nearly all."""
    known = np.where(np.isfinite(time_s), time_s, -np.inf)
    latest = np.maximum.accumulate(np.concatenate(([-np.inf], known[:-1])))
    rows = np.flatnonzero(known > latest)
    if rows.size < max((1.0 - MOST_REPEATED) * time_s.size, 2):
        first = int(np.flatnonzero(known <= latest)[0])
        raise InputError(where, f"time repeats or runs backwards in {time_s.size - rows.size} of {time_s.size} rows, "
                                f"first in row {first + 1}", restart_remedy(time_s, f"row {first + 1}") or
                         "sort the rows by time and keep one row a sample")
    return rows


def _sparse(columns: dict[str, FloatArray], time_s: FloatArray) -> list[tuple[FloatArray, dict[str, FloatArray]]]:
    """Columns by the rows that they have: signals merged into one table leave blanks at each other's times."""
    found: dict[bytes, tuple[FloatArray, dict[str, FloatArray]]] = {}
    for name, values in columns.items():
        present = np.isfinite(values)
        if present.mean() > 0.9:  # a gap stays a gap
            present = np.ones_like(present)
        if present.sum() < 2:
            continue
        found.setdefault(present.tobytes(), (time_s[present], {}))[1][name] = values[present]
    return list(found.values())
