"""Run files of any kind as data sets with the input that the rig's mechanism is driven by."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from daq import Dataset, Flag, InputError, Rig
from experiments.console import detail, progress
from experiments.exchange import load_any_run
from experiments.session.inputs import driven

SAME_RATE = 1.05
"""Ratio of rates below which two clocks differ, not two settings."""


def load_runs(paths: Sequence[Path | str], rig: Rig, damaged: bool = False) -> tuple[Dataset, ...]:
    """The runs of `paths` in their order, columns (n,) in SI units, on the grid of the rig's `[sampling] rate_hz`.

    Without that, on one grid of the lowest rate of the files.

    Raises `InputError` for a file that cannot be read, and for a damaged one unless `damaged` ones are wanted, and
    `FitError` as `driven`.
    """
    read = [_read(path, rig) for path in progress(list(paths), "reading runs", unit="run")]
    slowest = min((data.rate_hz for data in read), default=0.0)
    read = [data if data.rate_hz <= slowest else _averaged(path, rig, data, slowest)
            for path, data in zip(paths, read, strict=True)]
    return tuple(driven(require_whole(data, damaged), rig) for data in read)


def _averaged(path: Path | str, rig: Rig, data: Dataset, rate_hz: float) -> Dataset:
    """The run on a slower grid than its `data`."""
    text = f"is averaged from {data.rate_hz:g} to {rate_hz:g} samples a second, the lowest rate of these runs"
    data = _read(path, rig, rate_hz)
    if data.rate_hz < SAME_RATE * rate_hz:
        return data
    return replace(data, flags=(*(flag for flag in data.flags if flag.kind != "grid"), Flag("grid", text)))


def _read(path: Path | str, rig: Rig, rate_hz: float | None = None) -> Dataset:
    started = time.monotonic()
    data = load_any_run(path, rig, rate_hz)
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


def faulty_readings(datasets: Sequence[Dataset]) -> list[dict[str, object]]:
    """Readings that no device can give in the runs, and what was done with them: `readings` of every document."""
    return [{"run": data.name, **fault.document} for data in datasets for fault in data.readings]
