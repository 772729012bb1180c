"""Columns of numbers in mappings, structs, matrices and lists of records.

| held as | called |
| --- | --- |
| field of a struct, key of a mapping | `log.q` (`log/q` in HDF5) |
| column of a matrix, the longer side being the samples | `q[1]` |
| list of records, one a sample | by the records' keys |

Cells, lists of trials and arrays of three dimensions are left out with a reason.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from daq import FloatArray

LONGEST = 64
"""More columns than this are images and clouds, not signals."""
FEWEST_RECORDS = 20
"""A shorter list of mappings is a list of trials, not of samples."""
NO_TABLE = "is no table of numbers: save each of its parts under a name of its own"


def columns_of(value: Any, prefix: str = "", joint: str = ".") -> tuple[dict[str, FloatArray], dict[str, str]]:
    """Name -> (n,) numbers of every column in `value`, and name -> reason of each part that is no table."""
    parts = list(_parts(value, prefix, joint))
    return ({name: numbers for name, numbers in parts if numbers is not None},
            {name: NO_TABLE for name, numbers in parts if numbers is None})


def _parts(value: Any, prefix: str, joint: str) -> Iterator[tuple[str, FloatArray | None]]:
    """(name, (n,) numbers) of every column; None for what is no table."""
    if isinstance(value, np.ndarray) and value.dtype.names:
        value = {name: value[name] for name in value.dtype.names}
    if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.dtype.kind == "O"):
        items = list(value.ravel()) if isinstance(value, np.ndarray) else list(value)
        value = _stacked(items)
        if value is None and not all(isinstance(item, str | bytes | int | float | None) for item in items):
            yield prefix, None
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _parts(inner, f"{prefix}{joint}{name}" if prefix else str(name), joint)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        value = value.squeeze()
        if value.ndim > 2:
            yield prefix, None
        elif value.ndim == 1 and value.size > 1:
            yield prefix, value.astype(np.float64)
        elif value.ndim == 2 and min(value.shape) <= LONGEST:
            for k, column in enumerate(value.T if value.shape[1] <= value.shape[0] else value, 1):
                yield f"{prefix}[{k}]", column.astype(np.float64)


def _stacked(items: list[Any]) -> np.ndarray | dict[str, Any] | None:
    """One array, or one array a key, of a list of samples; None where the items are no samples."""
    known = [item for item in items if item is not None]
    if len(items) < 2 or not known:
        return None
    if all(isinstance(item, Mapping) for item in items):
        keys = [key for key in items[0] if all(key in item for item in items)]
        return None if len(items) < FEWEST_RECORDS else {str(key): [item[key] for item in items] for key in keys}
    try:
        rows = np.asarray(known)
        rows = rows.astype(np.float64) if rows.dtype.kind == "O" else rows
    except (TypeError, ValueError):
        return None
    if rows.dtype.kind not in "fiub" or rows.ndim > 2 or (
            rows.ndim == 2 and (rows.shape[1] > LONGEST or len(items) < FEWEST_RECORDS)):
        return None
    out = np.full((len(items), *rows.shape[1:]), np.nan)
    out[[item is not None for item in items]] = rows
    return out
