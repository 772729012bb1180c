"""Flags of the runs: their own, and contradictions with the rig in use."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import msgspec

from daq import Dataset, Flag, InputError, Rig

COMPARED = ("mechanism", "terms", "imu", "motor", "calibration")
"""Tables that are facts of the rig; the others are choices of a recording or of an analysis."""
PLAIN = ("rig", "rows", "grid", "readings")
"""Kinds of flags that state a fact, or name readings that were left out; the others make the run suspect."""


@dataclass(frozen=True)
class RunFlag:
    """A flag and its run."""

    run: str
    flag: Flag

    def __str__(self) -> str:
        return f"{self.run} {self.flag}" if self.flag.kind in PLAIN else f"{self.run} is suspect: {self.flag}"


def flags_of(datasets: Sequence[Dataset], rig: Rig) -> tuple[RunFlag, ...]:
    """Flags of every run, in order: its own, then the entries of its rig file that `rig` contradicts."""
    return tuple(RunFlag(data.name, flag) for data in datasets
                 for flag in (*data.told, *_contradictions(data, rig)))


def contradictions(flags: Iterable[RunFlag]) -> list[str]:
    """Those that say that a run was recorded on another rig than the one in use."""
    return [str(one) for one in flags if one.flag.kind == "rig"]


def require_one_rig(datasets: Sequence[Dataset]) -> None:
    """Raises `InputError` where two native runs were recorded on rigs that differ in what a model depends on."""
    first: Dataset | None = None
    for data in datasets:
        rig = data.recorded_on
        if rig is None:
            continue
        if first is None or first.recorded_on is None:
            first = data
        elif (rig.mechanism, rig.imus, rig.motor) != (
                first.recorded_on.mechanism, first.recorded_on.imus, first.recorded_on.motor):
            raise InputError(data.name, f"was recorded on another rig than {first.name}", "diagnose one rig at a time")


def _contradictions(data: Dataset, rig: Rig) -> list[Flag]:
    if data.recorded_on is None:
        return []
    then, now = _tables(data.recorded_on), _tables(rig)
    return [Flag("rig", f"was recorded with {table}.{key} = {value}, the rig file in use says {now[table][key]}")
            for table in then.keys() & now.keys() for key, value in then[table].items()
            if value != now[table][key] and value is not None]  # what a recording left open contradicts nothing


def _tables(rig: Rig) -> dict[str, dict[str, object]]:
    """Name to entries of the tables that are compared; of several IMUs one each."""
    found = {table: msgspec.to_builtins(getattr(rig, table)) for table in COMPARED if table != "imu"}
    return found | {f"imu {k + 1}" if k else "imu": msgspec.to_builtins(imu) for k, imu in enumerate(rig.imus)}
