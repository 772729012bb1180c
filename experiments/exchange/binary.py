"""MATLAB and Parquet files, written by legid or by anyone else."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from daq import FloatArray, InputError
from experiments.exchange.archives import read_hdf5
from experiments.exchange.imported import ImportedFile, Wrong, by_length, needs
from experiments.exchange.tree import columns_of

OWN_FACTS = ("rate_hz", "clock_bound_s")
"""Facts of an own export that are not columns."""


def read_mat(path: Path) -> ImportedFile:
    """Vectors of a .mat file, called as in `tree`. Raises `InputError`, and what SciPy raises."""
    from scipy.io import loadmat
    from scipy.io.matlab import varmats_from_mat

    try:
        with warnings.catch_warnings(record=True) as told:  # of names that occur twice: the last variable stays
            warnings.simplefilter("always")
            content = loadmat(str(path), simplify_cells=True)
    except NotImplementedError:  # version 7.3
        return read_hdf5(path)
    twice = [found[1] for one in told if (found := re.search('Duplicate variable name "(.+?)"', str(one.message)))]
    parts = [content]
    if "None" in twice:  # all objects have one name
        with path.open("rb") as file:
            parts = [loadmat(part, simplify_cells=True) for _, part in varmats_from_mat(file)]  # type: ignore[arg-type]
    objects = {name: kind for part in parts for value in part.values() for name, kind in _objects(value)}
    columns, left_out = columns_of({name: value for name, value in content.items()
                                    if not name.startswith("__") and not list(_objects(value))})
    facts = {name: repr(float(content[name])) for name in OWN_FACTS if np.ndim(content.get(name, [])) == 0}
    facts |= {"run": str(content["run"])} if isinstance(content.get("run"), str) else {}
    if objects and not columns:
        first, kind = next(iter(objects.items()))
        raise InputError(path.name, f"{', '.join(objects)} {'are' if len(objects) > 1 else 'is a'} MATLAB {kind} object"
                         f"{'s' * (len(objects) > 1)}, which only MATLAB can read",
                         f"save {first}.Time and {first}.Data, or struct({first})")
    left_out |= {name: f"is a MATLAB {kind} object, which only MATLAB can read: save struct({name}) or {name}.Data "
                 "instead" for name, kind in objects.items()}
    return ImportedFile(path.name, by_length(columns), facts, left_out, wrong=tuple(
        Wrong("the first of two variables", name, "has the name of the second") for name in twice if name != "None"))


def _objects(value: object) -> Iterator[tuple[str, str]]:
    """Name and class of a variable that is a MATLAB object: SciPy gives no data of it."""
    from scipy.io.matlab import MatlabOpaque

    if isinstance(value, MatlabOpaque):
        for row in np.atleast_1d(value):
            name, kind = (str(row[field].decode() if isinstance(row[field], bytes) else row[field])
                          for field in ("s0", "s2"))
            yield name, kind


def _floats(values: np.ndarray) -> FloatArray | None:
    """(n,) floats, times as seconds from the first; None where `values` are no column of numbers."""
    if values.size > 1 and values.dtype.kind == "M":
        return (values - values[0]).astype("timedelta64[ns]").astype(np.float64) * 1e-9
    return values.astype(np.float64) if values.size > 1 and values.dtype.kind in "fiub" else None


def read_parquet(path: Path) -> ImportedFile:
    """Columns of numbers of a Parquet file, those of a list called as in `tree`; null is NaN.

    Raises `InputError`, and what PyArrow raises.
    """
    try:
        from pyarrow import parquet, set_memory_pool, system_memory_pool, types
    except ImportError:
        raise needs(path, "pyarrow", "parquet") from None
    set_memory_pool(system_memory_pool())  # another reserves more than the reader's bound before it reads
    table = parquet.read_table(str(path), use_threads=False)
    columns: dict[str, FloatArray] = {}
    left_out: dict[str, str] = {}
    for name in table.column_names:
        numbers = _floats(table[name].to_numpy())
        if numbers is not None:
            columns[name] = numbers
            continue
        lists = types.is_list(table[name].type) or types.is_fixed_size_list(table[name].type)
        parts, _ = columns_of(table[name].to_pylist(), name) if lists else ({}, {})
        columns |= parts
        if not parts:
            left_out[name] = f"holds {table[name].type}, no column of numbers"
    written = {k.decode(): v.decode("utf-8", "replace") for k, v in (table.schema.metadata or {}).items()}
    facts = {name: written[f"legid.{name}"] for name in ("run", *OWN_FACTS) if f"legid.{name}" in written}
    return ImportedFile(path.name, by_length(columns), facts, left_out)
