"""One run as structs, archives and lists of records hold it."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from scipy.io import savemat

Columns = Mapping[str, np.ndarray]
Maker = Callable[[Columns, Path], None]


def structs(columns: Columns, path: Path) -> None:
    savemat(path, {"log": {"time": columns["t"], "state": {"q": np.column_stack([columns["a"], columns["b"]])}}})


def npz(columns: Columns, path: Path) -> None:
    np.savez(path, **dict(columns))  # type: ignore[arg-type]


def records(columns: Columns, path: Path) -> None:
    rows = [dict(zip(columns, map(float, row))) for row in zip(*columns.values())]
    path.write_text(json.dumps({"meta": "x", "entries": rows}))
