"""Columns of numbers in what a file holds nested: mappings and structs, cells and lists, arrays of several columns.

| held as | called |
| --- | --- |
| field of a struct, key of a mapping | `log.q` (`log/q` in HDF5) |
| column of a matrix, the longer side being the samples | `q[1]` |
| cell, or element of an array of structs | `log{1}` |
| list of records, one a sample | by the records' keys |
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from daq import FloatArray
from experiments.exchange.imported import as_floats

LONGEST = 64
"""More columns than this are images and clouds, not signals."""
FEWEST_RECORDS = 20
"""A shorter list of mappings is a list of trials, not of samples."""


def vectors(value: Any, prefix: str = "", joint: str = ".") -> Iterator[tuple[str, FloatArray]]:
    """(name, (n,) numbers) of everything in `value` that is a column of numbers."""
    if isinstance(value, np.ndarray) and value.dtype.names:
        value = {name: value[name] for name in value.dtype.names}
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from vectors(inner, f"{prefix}{joint}{name}" if prefix else str(name), joint)
        return
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        yield from _columns(value, prefix)
        return
    if not isinstance(value, Sequence | np.ndarray) or isinstance(value, str | bytes):
        return
    items = list(value.ravel()) if isinstance(value, np.ndarray) and value.dtype.kind == "O" else list(value)
    table = _stacked(items)
    if isinstance(table, Mapping):
        yield from vectors(table, prefix, joint)
    elif table is not None:
        yield from _columns(table, prefix)
    else:
        for k, inner in enumerate(items):
            yield from vectors(inner, f"{prefix}{{{k + 1}}}", joint)


def _columns(value: np.ndarray, prefix: str) -> Iterator[tuple[str, FloatArray]]:
    value = value.squeeze() if value.ndim > 1 else value
    if value.ndim == 2 and value.shape[1] > value.shape[0]:
        value = value.T
    if value.ndim == 1 and (numbers := as_floats(value)) is not None:
        yield prefix, numbers
    elif value.ndim == 2 and value.shape[1] <= LONGEST:
        for k, column in enumerate(value.T):
            if (numbers := as_floats(column)) is not None:
                yield f"{prefix}[{k + 1}]", numbers
    elif value.ndim == 3 and value.shape[0] <= LONGEST:
        for k, inner in enumerate(value):
            yield from _columns(inner, f"{prefix}{{{k + 1}}}")


def _stacked(items: list[Any]) -> np.ndarray | dict[str, Any] | None:
    """One array, or one array a key, of a list of samples; None where the items are no samples."""
    if len(items) < 2:
        return None
    if all(isinstance(item, Mapping) for item in items):
        keys = [key for key in items[0] if all(key in item for item in items)]
        columns = {str(key): [item[key] for item in items] for key in keys}
        if len(items) < FEWEST_RECORDS or any(np.size(v) > LONGEST for c in columns.values() for v in c[:1]
                                              if isinstance(v, np.ndarray | list | tuple)):
            return None
        return columns
    sizes = {np.shape(item) for item in items if isinstance(item, int | float | np.number | list | tuple | np.ndarray)
             and not _ragged(item)}
    numbers = all(isinstance(item, int | float | np.number | list | tuple | np.ndarray | None) for item in items)
    if not numbers or len(sizes) != 1 or any(_ragged(item) for item in items):
        return None
    (shape,) = sizes
    if shape and (len(shape) > 1 or shape[0] > LONGEST or len(items) < FEWEST_RECORDS):
        return None
    try:
        blank = np.full(shape, np.nan)
        return np.array([blank if item is None else item for item in items], dtype=np.float64)
    except (TypeError, ValueError):
        return None


def _ragged(item: Any) -> bool:
    if isinstance(item, list | tuple):
        return any(isinstance(one, Mapping | list | tuple | str | np.ndarray) for one in item)
    return isinstance(item, np.ndarray) and item.dtype.kind not in "fiub"
