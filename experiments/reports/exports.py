"""A data set as CSV, Parquet or a MATLAB file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from daq import Dataset, InputError, load_rig, load_run
from daq.runs import read_csv, read_run, write_csv
from daq.timing import align, align_table, recorded_rig


def load_any(path: Path | str, rig_path: Path | str | None, rate_hz: float | None) -> Dataset:
    """A run with the rig given, the rig inside it, or, for a CSV, none at all. Raises `InputError`."""
    if rate_hz is not None and not 0.0 < rate_hz < 1e6:
        raise InputError("--rate", f"{rate_hz:g} is not a rate in Hz", "give samples per second")
    if rig_path is not None:
        return load_run(path, load_rig(rig_path), rate_hz)
    if str(path).lower().endswith(".mcap"):
        raw = read_run(path)
        return align(raw, recorded_rig(raw), rate_hz)
    table = read_csv(path)
    return align_table(table, rate_hz or 1.0 / float(np.median(np.diff(table.time_s))))


def export_run(data: Dataset, kind: str, path: Path | str) -> int:
    """Write `data`; returns the number of rows. Raises `InputError`.

    CSV leaves out rows with a gap, as its contract asks; Parquet (null) and MATLAB (NaN) keep them.
    """
    if kind == "csv":
        return write_csv(data, path)
    try:
        if kind == "parquet":
            _write_parquet(data, path)
        else:
            _write_mat(data, path)
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), "give a place that can be written") from None
    return len(data)


def _write_parquet(data: Dataset, path: Path | str) -> None:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise InputError("--to parquet", "needs the package pyarrow",
                         'install it: pip install "legid[parquet]"') from None
    columns = {"time_s": data.time_s, **data.columns}
    table = pa.table({name: pa.array(values, from_pandas=True) for name, values in columns.items()})
    facts = {"legid.run": data.name, "legid.rate_hz": repr(data.rate_hz), **data.sources}
    parquet.write_table(table.replace_schema_metadata({str(k): str(v) for k, v in facts.items()}), path)


def _write_mat(data: Dataset, path: Path | str) -> None:
    from scipy.io import savemat

    savemat(str(path), {"run": data.name, "rate_hz": data.rate_hz, "time_s": data.time_s, **data.columns},
            appendmat=False, oned_as="column")
