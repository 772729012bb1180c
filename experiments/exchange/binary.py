"""MATLAB and Parquet files, written by legid or by anyone else."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from daq import FloatArray, InputError
from experiments.exchange.foreign import Foreign, as_floats, by_length

OWN_FACTS = ("rate_hz", "clock_bound_s")
"""Facts of an own export that are not columns."""


def read_mat(path: Path) -> Foreign:
    """Vectors of a .mat file up to version 7.2; fields of a struct as `struct.field`, columns of a matrix numbered.

    Raises `InputError`.
    """
    from scipy.io import loadmat

    try:
        content = loadmat(str(path), simplify_cells=True)
    except NotImplementedError:
        raise InputError(str(path), "is a MATLAB file of version 7.3", "save it with save(..., '-v7')") from None
    except Exception as error:
        raise InputError(str(path), f"cannot be read as a MATLAB file ({error})", "give a whole .mat file") from None
    columns = dict(_vectors({k: v for k, v in content.items() if not k.startswith("__")}))
    facts = {name: repr(float(content[name])) for name in OWN_FACTS if np.ndim(content.get(name, [])) == 0}
    facts |= {"run": str(content["run"])} if isinstance(content.get("run"), str) else {}
    return Foreign(path.name, by_length(columns), facts)


def _vectors(value: Any, prefix: str = "") -> Iterator[tuple[str, FloatArray]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _vectors(inner, f"{prefix}.{name}" if prefix else str(name))
    elif (numbers := as_floats(value)) is not None:
        yield prefix, numbers
    elif isinstance(value, np.ndarray) and value.ndim == 2 and value.dtype.kind in "fiub":
        for k, column in enumerate(value.T):
            if (numbers := as_floats(column)) is not None:
                yield f"{prefix}[{k + 1}]", numbers


def read_parquet(path: Path) -> Foreign:
    """Columns of numbers of a Parquet file; null is NaN. Raises `InputError`."""
    try:
        from pyarrow import parquet
    except ImportError:
        raise InputError(str(path), "needs the package pyarrow", 'install it: pip install "legid[parquet]"') from None
    try:
        table = parquet.read_table(str(path))
    except Exception as error:
        raise InputError(str(path), f"cannot be read as Parquet ({error})", "give a whole Parquet file") from None
    columns: dict[str, FloatArray] = {}
    for name in table.column_names:
        numbers = as_floats(table[name].to_numpy())
        if numbers is not None:
            columns[name] = numbers
    written = {k.decode(): v.decode("utf-8", "replace") for k, v in (table.schema.metadata or {}).items()}
    facts = {name: written[f"legid.{name}"] for name in ("run", *OWN_FACTS) if f"legid.{name}" in written}
    return Foreign(path.name, by_length(columns), facts)
