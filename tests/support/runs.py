"""A run of legid's own kinds on the grid of a rig, without the floor that reads other programs' files."""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq import Dataset, Rig
from daq.runs import read_csv, read_run
from daq.timing import align_table
from daq.timing.align import align


def with_columns(run: Dataset, **columns: np.ndarray) -> Dataset:
    """The run with these columns, new or in place of its own."""
    return replace(run, columns={**run.columns, **columns})


def without(run: Dataset, *names: str) -> Dataset:
    """The run without these columns."""
    return replace(run, columns={name: values for name, values in run.columns.items() if name not in names})


def records(data: bytes) -> list[tuple[int, int, int]]:
    """(opcode, start, end) of every record in an MCAP file, those inside chunks apart."""
    found, at = [], 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append((opcode, at, at + 9 + length))
        at += 9 + length
    return found


def load_run(path: Path, rig: Rig, rate_hz: float | None = None) -> Dataset:
    if path.suffix == ".mcap":
        return align(read_run(path), rig, rate_hz)
    return align_table(read_csv(path, rig), rate_hz or rig.sampling.rate_hz)
