"""A file of any known kind to a run, by the rig: its own formats, and those of others by `[columns]`."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq import Column, Dataset, InputError, Rig, input_errors, load_rig, open_regular
from daq.runs import SUFFIXES, missing, read_csv
from daq.timing import align_table
from experiments.exchange.archives import read_hdf5, read_json, read_numpy
from experiments.exchange.binary import read_mat, read_parquet
from experiments.exchange.bounded import Reader, read_bounded
from experiments.exchange.can_log import SUFFIXES as CAN_LOGS
from experiments.exchange.can_log import is_candump, read_can_log
from experiments.exchange.column_map import ColumnMap, applies, apply_map, check_map, identity, require_scales
from experiments.exchange.delimited import read_delimited
from experiments.exchange.imported import ImportedFile
from experiments.exchange.layouts import with_layout
from experiments.exchange.rosbag import read_bag

NATIVE = "legid "
"""How the library that an MCAP header names begins in a run of ours."""
POINTER, MOST_POINTER = b"version https://git-lfs.github.com/spec/", 1024
"""What stands in place of a file in a clone without Git LFS, and its size at most."""
TEXT = (".csv", ".csv.gz", ".txt", ".tsv", ".dat", ".log")
CLOCK_BOUND = "/imu/clock_bound/data"
OWN_TOPICS = {
    "q1_rad": Column(name="/joint_states/pivot/position"),
    "q2_rad": Column(name="/joint_states/knee/position"),
    "tau2_nm": Column(name="/joint_torques/knee/effort"),
    "tau2_cmd_nm": Column(name="/joint_commands/knee/effort"),
    "gyro_radps": Column(name="/imu/angular_velocity/z", sign=-1),
    "accel_x_mps2": Column(name="/imu/linear_acceleration/x"),
    "accel_y_mps2": Column(name="/imu/linear_acceleration/y"),
}
"""How the messages of `legid export --to ros2` are read back."""
SOME_KINDS = (".mcap, .csv, .csv.gz, .txt, .tsv, .parquet, .mat, .npz, .npy, .h5, .json, .db3, a bag's folder, or a "
              "CAN log (.log, .asc, .blf)")
PICKLES = {".pkl": "pickle", ".pickle": "pickle", ".pt": "PyTorch", ".pth": "PyTorch"}
"""Files that hold a program, which legid does not run -> whose."""

_BAG, _CAN = Reader(read_bag, "a ROS bag", "rosbags.highlevel"), Reader(read_can_log, "a CAN log", "can")
_READERS: tuple[tuple[tuple[str, ...], Reader], ...] = (
    ((".mcap", ".db3", ".bag"), _BAG), ((".mat",), Reader(read_mat, "a MATLAB file", "scipy.io")),
    ((".h5", ".hdf5"), Reader(read_hdf5, library="h5py")), ((".npz", ".npy"), Reader(read_numpy)),
    ((".json",), Reader(read_json)),
    ((".parquet",), Reader(read_parquet, "Parquet", "pyarrow.parquet")),
    (CAN_LOGS, _CAN), (TEXT, Reader(read_delimited, "a table of text")))
"""Ending of the name -> what reads it."""


def read_imported(path: Path | str) -> ImportedFile:
    """The samples of a file of any program, by its name's ending. Raises `InputError`, beyond the bounds of memory and
    time that a file has, too."""
    path, name = Path(path), str(path).lower()
    with input_errors(path, "give a file that is there"):
        if path.is_dir():
            inside = [inner for inner in path.rglob("*") if not inner.is_dir()]
            return read_bounded(_BAG, path, sum(map(_size, inside)))
        size = _size(path)
    if _is_pointer(path, size):
        raise InputError(str(path), "is a pointer of Git LFS, not the file", "fetch it with git lfs pull")
    reader = next((reader for endings, reader in _READERS if name.endswith(endings)), None)
    if name.endswith(".log") and is_candump(path):
        reader = _CAN
    program = PICKLES.get(path.suffix.lower())
    if program is not None:
        raise InputError(str(path), f"is a {program} file, a program that legid does not run",
                         "save its columns as CSV, Parquet or .npz: see docs/exchange.md, Kinds of file")
    if reader is None:
        raise InputError(str(path), "is of no kind that is known", f"give {SOME_KINDS}")
    return with_layout(read_bounded(reader, path, size), path)


def _is_pointer(path: Path, size: int) -> bool:
    """Whether a clone without Git LFS left this in place of the file."""
    if size > MOST_POINTER:
        return False
    with open_regular(path) as file:
        return bool(file.read(len(POINTER)) == POINTER)


def _size(path: Path) -> int:
    """Bytes of a regular file. Raises `InputError` for any other, `OSError` for none."""
    with open_regular(path) as file:
        return os.fstat(file.fileno()).st_size


def is_native(path: Path | str) -> bool:
    """A run that legid recorded, by the program that its MCAP header names; what is no whole MCAP counts as one too.

    Its reader then says what is wrong with it.
    """
    if not str(path).lower().endswith(".mcap") or Path(path).is_dir():
        return False
    from daq.runs import written_by  # with a reader of MCAP, which a CSV needs none of

    library = written_by(Path(path))
    return library is None or library.startswith(NATIVE)


def load_any_run(path: Path | str, rig: Rig, rate_hz: float | None = None) -> Dataset:
    """A run on the grid of `rate_hz` (default: the rig's, else the file's own) from a file of any kind.

    Native runs and CSV by the contract are read as such; what `legid export` wrote comes back as it was; files of
    other programs go through the rig's `[columns]`. Raises `InputError`.
    """
    rate = rate_hz or rig.sampling.rate_hz
    csv = str(path).lower().endswith(SUFFIXES)
    if is_native(path) or (csv and not rig.columns):
        return _own(Path(path), rig, rate)
    imported = read_imported(path)
    columns = check_map(dict(rig.columns), "the rig file") if rig.columns else {}
    require_scales(columns, "the rig file")
    if csv and not applies(imported, columns):
        return _own(Path(path), rig, rate)
    run = mapped(imported, columns, rate, rig.sampling.as_read)
    lacking = missing(rig, ["time_s", *run.columns])
    if lacking is not None:
        raise InputError(str(path), f"gives no {lacking.column}",
                         lacking.remedy if imported.names == list(run.columns) or "[servo]" in lacking.remedy else
                         f"map a column to it by [columns.{lacking.column}] in the rig file, or by legid import")
    return run


def _own(path: Path, rig: Rig, rate_hz: float | None) -> Dataset:
    """A run of legid's own two kinds."""
    if path.name.lower().endswith(SUFFIXES):
        return align_table(read_csv(path, rig), rate_hz, rig.sampling.as_read)
    from daq.runs import read_run  # MCAP and clocks take a while to load
    from daq.timing import align

    return align(read_run(path), rig, rate_hz)


def mapped(imported: ImportedFile, columns: ColumnMap, rate_hz: float | None, as_read: bool = False) -> Dataset:
    """`imported` as a run by a map, or as what `legid export` wrote where the map does not speak of its columns."""
    if columns and applies(imported, columns):
        return apply_map(imported, columns, rate_hz, as_read)
    own = {name: column for name, column in OWN_TOPICS.items() if column.name in imported.names}
    run = own_export(imported, rate_hz) or apply_map(imported, own or identity(imported), rate_hz, as_read)
    if own and CLOCK_BOUND in imported.names:
        return replace(run, clock_bound_s=float(imported.values(CLOCK_BOUND)[0]))
    return run


def own_export(imported: ImportedFile, rate_hz: float | None) -> Dataset | None:
    """The run that `legid export` wrote, to the bit; None where the file is not one, or the grid another."""
    written = float(imported.facts.get("rate_hz", "nan"))
    if not np.isfinite(written) or "time_s" not in imported.names or (rate_hz or written) != written:
        return None
    columns = dict(imported.table_of("time_s").columns)
    time_s = columns.pop("time_s")
    return Dataset(imported.facts.get("run", imported.name), written, time_s, columns,
                   float(imported.facts.get("clock_bound_s", "0")))


def load_to_convert(path: Path | str, rig_path: Path | str | None, rate_hz: float | None) -> Dataset:
    """A run with the rig given, the rig inside it, or none where the file needs none. Raises `InputError`."""
    if rate_hz is not None and not 0.0 < rate_hz < 1e6:
        raise InputError("--rate", f"{rate_hz:g} is not a rate in Hz", "give samples per second")
    if rig_path is not None:
        return load_any_run(path, load_rig(rig_path), rate_hz)
    if is_native(path):
        from daq.runs import read_run
        from daq.timing import align, recorded_rig

        raw = read_run(path)
        return align(raw, recorded_rig(raw), rate_hz)
    if not str(path).lower().endswith(SUFFIXES):
        return mapped(read_imported(path), {}, rate_hz)
    table = read_csv(path)
    return align_table(table, rate_hz)
