"""Any run file to a `Dataset`: by the file's name, CSV or MCAP."""

from __future__ import annotations

from pathlib import Path

from daq.dataset import Dataset
from daq.errors import InputError
from daq.rig import Rig
from daq.runs import read_csv
from daq.timing import align_table

SUFFIXES = (".csv", ".csv.gz")


def load_run(path: Path | str, rig: Rig, rate_hz: float | None = None) -> Dataset:
    """Run at `path` on the grid of `rate_hz` (default: the rig's). Raises `InputError`."""
    path = Path(path)
    rate = rig.sampling.rate_hz if rate_hz is None else rate_hz
    if path.name.lower().endswith(SUFFIXES):
        return align_table(read_csv(path, rig), rate)
    if path.suffix.lower() == ".mcap":
        from daq.runs import read_run  # MCAP and clocks take a while to load
        from daq.timing import align

        return align(read_run(path), rig, rate)
    raise InputError(str(path), "is neither .csv, .csv.gz nor .mcap", "give a run file of one of these kinds")
