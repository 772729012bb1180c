"""`Dataset`: a run that shows itself and remembers its rig and file; it goes wherever the floor's own is taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from msgspec import structs

from daq import Dataset as PlainDataset
from daq import Rig
from experiments.console import command_line
from experiments.provenance import Origin, Source, origin_of
from legid.tables import Shown, frame

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


def sources_of(runs: Sequence[PlainDataset]) -> tuple[Source, ...]:
    """The files of those that were loaded from one."""
    return tuple(run.source for run in runs if isinstance(run, Dataset) and run.source is not None)


def origin_from(runs: Sequence[Source], rig: Source | None = None, model: Source | None = None,
                models: Sequence[Source] = (), seed: int | None = None) -> Origin:
    """Everything that a verb was given, and the command that called it, if one did."""
    return structs.replace(origin_of(rig=rig, seed=seed, command=command_line()), runs=tuple(runs), model=model,
                           models=tuple(models))


@dataclass(frozen=True, repr=False)
class Dataset(Shown, PlainDataset):
    """One run on a uniform grid: columns of contract names in SI units, NaN where a sample is missing."""

    rig: Rig | None = None
    """The rig that it was loaded with; None for a run that was simulated or made by hand."""
    source: Source | None = None
    """The file that it was loaded from."""
    rig_source: Source | None = None
    """The file of its rig."""

    @classmethod
    def of(cls, data: PlainDataset, rig: Rig | None = None, source: Source | None = None,
           rig_source: Source | None = None) -> Dataset:
        """The same run with its rig and file."""
        return cls(**{one.name: getattr(data, one.name) for one in fields(PlainDataset)}, rig=rig, source=source,
                   rig_source=rig_source)

    def to_frame(self) -> DataFrame:
        """One row a sample, `time_s` [s] as index, one column a signal. Raises `WorkError` without pandas."""
        return frame({"time_s": self.time_s, **self.columns}, "time_s")

    def plot(self) -> Figure:
        """Every column over time."""
        from legid.figures import dataset_figure

        return dataset_figure(self)

    def _head(self) -> str:
        return f"{self.name}: {len(self)} samples at {self.rate_hz:g} Hz, {len(self) / self.rate_hz:.1f} s"

    def __str__(self) -> str:
        return f"{self._head()}, columns {', '.join(self.columns)}"
