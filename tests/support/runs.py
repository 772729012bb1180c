"""A run of legid's own kinds on the grid of a rig, without the floor that reads other programs' files."""

from pathlib import Path

from daq.dataset import Dataset
from daq.rig import Rig
from daq.runs.csv_run import read_csv
from daq.runs.mcap_run import read_run
from daq.timing.align import align
from daq.timing.resample import align_table


def load_run(path: Path, rig: Rig, rate_hz: float | None = None) -> Dataset:
    if path.suffix == ".mcap":
        return align(read_run(path), rig, rate_hz)
    return align_table(read_csv(path, rig), rate_hz or rig.sampling.rate_hz)
