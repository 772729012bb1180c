"""Columns computed from a file's own: `shank - thigh`, `q - 0.2 * 'motor current'`, and runs in numbered cells.

The operators are + - * / and brackets, on numbers and columns. A column's name may stand as it is, whatever it
contains; of two that fit the longer one counts, and quotes settle the rest. A column of this very name goes before an
expression.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from msgspec import structs

from daq import Column, FloatArray, InputError
from experiments.exchange.imported import ImportedFile, Table

OPERATORS: dict[type[ast.operator], Callable[[FloatArray, FloatArray], FloatArray]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv}
ANY = "{*}"
"""In a map, the number of a cell or of a trial: one run is made of each."""
NUMBERED = re.compile(r"\{(\d+)\}")


def with_computed(imported: ImportedFile, columns: Mapping[str, Column]) -> ImportedFile:
    """`imported` with a column for each expression among the names of `columns`. Raises `InputError`."""
    for name in dict.fromkeys(column.name for column in columns.values()):
        used = () if name in imported.names or name in imported.left_out else tuple(names_in(name, imported.names))
        if used and used != (name,):
            imported = _with(imported, name, used)
    return imported


def names_in(text: str, names: list[str]) -> Iterator[str]:
    """The columns that an expression uses, in its order."""
    yield from (found for _, found in _tokens(text, names) if found)


def _tokens(text: str, names: list[str]) -> Iterator[tuple[str, str]]:
    """(text, the column that it names or nothing) of the expression from left to right."""
    known = sorted(names, key=len, reverse=True)
    at = 0
    while at < len(text):
        quoted = re.match(r"'([^']*)'", text[at:])
        found = quoted[1] if quoted else next((name for name in known if text.startswith(name, at) and _ends(
            text, at, name)), "")
        piece = quoted[0] if quoted else found or re.match(r"\d+\.?\d*(?:[eE][-+]?\d+)?|\w+|.", text[at:])[0]  # type: ignore[index]
        yield piece, found
        at += len(piece)


def _ends(text: str, at: int, name: str) -> bool:
    """`name` at this place is a whole word."""
    before, after = text[at - 1:at], text[at + len(name):at + len(name) + 1]
    return not (re.match(r"\w", name[:1]) and re.match(r"[\w.]", before)) and not (
        re.match(r"\w", name[-1:]) and re.match(r"\w", after))


def _with(imported: ImportedFile, text: str, used: tuple[str, ...]) -> ImportedFile:
    home = imported.table_of(used[0])
    place = {name: f"_{k}" for k, name in enumerate(dict.fromkeys(used))}
    values = {place[name]: _on_times_of(home, imported, name) for name in place}
    source = "".join(place.get(found, piece) for piece, found in _tokens(text, imported.names))
    try:
        with np.errstate(all="ignore"):
            made = _value(ast.parse(source.strip(), mode="eval").body, values)
    except (SyntaxError, KeyError, ValueError, RecursionError):
        raise InputError(imported.name, f"{text!r} is no column and no expression of its columns",
                         "use + - * / and brackets on numbers and columns, names with signs in quotes") from None
    made = np.where(np.isfinite(made), made, np.nan)
    if not np.isfinite(made).any():
        raise InputError(imported.name, f"{text!r} has no row in which all its columns have a number",
                         "save them with one time for all")
    tables = tuple(Table({**t.columns, text: made}, t.time_s) if t is home else t for t in imported.tables)
    return replace(imported, tables=tables)


def _on_times_of(home: Table, imported: ImportedFile, name: str) -> FloatArray:
    """Column `name` at the times of `home`, by straight lines where it has times of its own."""
    table = imported.table_of(name)
    values = table.columns[name]
    if table is home:
        return values
    if table.time_s is None or home.time_s is None:
        raise InputError(imported.name, f"column {name!r} has {values.size} rows, the others of its expression "
                                       f"{next(iter(home.columns.values())).size}", "save them with one time for all")
    return np.interp(home.time_s, table.time_s, values, left=np.nan, right=np.nan)


def _value(node: ast.expr, values: Mapping[str, FloatArray]) -> FloatArray:
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        return OPERATORS[type(node.op)](_value(node.left, values), _value(node.right, values))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        return _value(node.operand, values) * (-1.0 if isinstance(node.op, ast.USub) else 1.0)
    if isinstance(node, ast.Name):
        return values[node.id]
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return np.asarray(float(node.value))
    raise ValueError


def runs_in(imported: ImportedFile, columns: Mapping[str, Column]) -> list[tuple[str, dict[str, Column]]]:
    """(ending of its name, map) of every run that the map finds: one, or with `{*}` one a numbered cell."""
    if not any(ANY in column.name for column in columns.values()):
        return [("", dict(columns))]
    numbers = sorted({int(k) for name in imported.names for k in NUMBERED.findall(name)})
    out = []
    for k in numbers:
        own = {name: structs.replace(column, name=column.name.replace(ANY, f"{{{k}}}"))
               for name, column in columns.items()}
        if all(set(names_in(column.name, imported.names)) for column in own.values()):
            out.append((f"-{k:0{len(str(numbers[-1]))}d}", own))
    if not out:
        raise InputError(imported.name, f"has no numbered cell that holds all of the map's columns with {ANY}",
                         "name them as legid import shows them")
    return out
