"""MATLAB and Parquet files, written by legid or by anyone else."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np

from daq import FloatArray, InputError
from experiments.exchange.archives import read_archive
from experiments.exchange.imported import ImportedFile, Wrong, as_floats, by_length
from experiments.exchange.nested import vectors

OWN_FACTS = ("rate_hz", "clock_bound_s")
"""Facts of an own export that are not columns."""


def read_mat(path: Path) -> ImportedFile:
    """Vectors of a .mat file, called as in `nested`. Raises `InputError`, and what SciPy raises."""
    from scipy.io import loadmat

    try:
        with warnings.catch_warnings(record=True) as told:  # of names that occur twice: the last variable stays
            warnings.simplefilter("always")
            content = loadmat(str(path), simplify_cells=True)
    except NotImplementedError:  # version 7.3
        return read_archive(path)
    columns = dict(vectors({k: v for k, v in content.items() if not k.startswith("__")}))
    facts = {name: repr(float(content[name])) for name in OWN_FACTS if np.ndim(content.get(name, [])) == 0}
    facts |= {"run": str(content["run"])} if isinstance(content.get("run"), str) else {}
    twice = [found[1] for one in told if (found := re.search('Duplicate variable name "(.+?)"', str(one.message)))]
    return ImportedFile(path.name, by_length(columns), facts, wrong=tuple(
        Wrong("the first of two variables", name, "has the name of the second") for name in twice))


def read_parquet(path: Path) -> ImportedFile:
    """Columns of numbers of a Parquet file; null is NaN. Raises `InputError`, and what PyArrow raises."""
    try:
        from pyarrow import parquet, set_memory_pool, system_memory_pool
    except ImportError:
        raise InputError(str(path), "needs the package pyarrow", 'install it: pip install "legid[parquet]"') from None
    set_memory_pool(system_memory_pool())  # another reserves more than the reader's bound before it reads
    table = parquet.read_table(str(path), use_threads=False)
    columns: dict[str, FloatArray] = {}
    for name in table.column_names:
        numbers = as_floats(table[name].to_numpy())
        if numbers is not None:
            columns[name] = numbers
    written = {k.decode(): v.decode("utf-8", "replace") for k, v in (table.schema.metadata or {}).items()}
    facts = {name: written[f"legid.{name}"] for name in ("run", *OWN_FACTS) if f"legid.{name}" in written}
    return ImportedFile(path.name, by_length(columns), facts)
