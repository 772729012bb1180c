"""A run as CSV, Parquet or a MATLAB file, each of which `legid` reads again."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

from daq import Dataset, write_file
from daq.runs import write_csv
from experiments.exchange.imported import needs


def export_run(data: Dataset, kind: str, path: Path | str) -> int:
    """Write `data`; returns the number of rows. Raises `InputError`.

    CSV leaves out rows with a gap, as its contract asks; Parquet (null) and MATLAB (NaN) keep them, and every bit.
    """
    if kind == "csv":
        return write_csv(data, path)
    write_file(path, _parquet(data) if kind == "parquet" else _mat(data))
    return len(data)


def _parquet(data: Dataset) -> bytes:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise needs("--to parquet", "pyarrow", "parquet") from None
    columns = {"time_s": data.time_s, **data.columns}
    table = pa.table({name: pa.array(values, from_pandas=True) for name, values in columns.items()})
    facts = {"legid.run": data.name, "legid.rate_hz": repr(data.rate_hz),
             "legid.clock_bound_s": repr(data.clock_bound_s), "file": data.name,
             **{f"legid.{what}": "; ".join(map(str, found)) for what, found in
                (("damage", data.damage), ("doubts", data.told)) if found}}
    out = BytesIO()
    parquet.write_table(table.replace_schema_metadata({str(k): str(v) for k, v in facts.items()}), out)
    return out.getvalue()


def _mat(data: Dataset) -> bytes:
    from scipy.io import savemat

    out = BytesIO()
    columns = {"run": data.name, "rate_hz": data.rate_hz, "clock_bound_s": data.clock_bound_s, "time_s": data.time_s,
               **data.columns}
    savemat(out, columns, appendmat=False, oned_as="column")  # type: ignore[arg-type]  # its stubs know paths only
    return out.getvalue()
