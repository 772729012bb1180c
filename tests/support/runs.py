"""A run of legid's own kinds on the grid of a rig, without the floor that reads other programs' files."""

from pathlib import Path

from daq import Dataset, Rig
from daq.runs import read_csv, read_run
from daq.timing import align_table
from daq.timing.align import align


def load_run(path: Path, rig: Rig, rate_hz: float | None = None) -> Dataset:
    if path.suffix == ".mcap":
        return align(read_run(path), rig, rate_hz)
    return align_table(read_csv(path, rig), rate_hz or rig.sampling.rate_hz)
