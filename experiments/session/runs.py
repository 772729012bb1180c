"""Run files of any kind as data sets with the input that the rig's mechanism is driven by."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from daq import Dataset, InputError, Rig
from experiments.console import detail, progress
from experiments.exchange import load_any_run
from experiments.session.inputs import driven


def load_runs(paths: Sequence[Path | str], rig: Rig, damaged: bool = False) -> tuple[Dataset, ...]:
    """The runs of `paths` in their order, columns (n,) in SI units, on the grid of the rig's `[sampling] rate_hz`.

    Raises `InputError` for a file that cannot be read, and for a damaged one unless `damaged` ones are wanted, and
    `FitError` as `driven`.
    """
    return tuple(driven(require_whole(_read(path, rig), damaged), rig)
                 for path in progress(list(paths), "reading runs", unit="run"))


def _read(path: Path | str, rig: Rig) -> Dataset:
    started = time.monotonic()
    data = load_any_run(path, rig)
    detail(f"{path}: {len(data)} samples at {data.rate_hz:g} Hz, read in {time.monotonic() - started:.2f} s")
    return data


def require_whole(data: Dataset, damaged: bool = False) -> Dataset:
    """`data` itself. Raises `InputError` if its file is damaged and `damaged` is False."""
    if data.damage and not damaged:
        raise InputError(data.name, f"is damaged: {'; '.join(map(str, data.damage))}",
                         "save what is whole with legid recover, or use it as it is with --damaged")
    return data


def damaged_runs(datasets: Sequence[Dataset]) -> list[dict[str, str]]:
    """Runs of whose files something is missing, and what: `damaged` of every document."""
    return [{"run": d.name, "what": "; ".join(map(str, d.damage))} for d in datasets if d.damage]
