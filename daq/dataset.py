"""`Dataset`: one run on a uniform time grid, the only thing the estimator knows of the outside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from daq.findings import Damage, Flag, ReadingFault, Steps

if TYPE_CHECKING:
    from daq.loop import Loop
    from daq.rig import Rig
    from daq.rig_imu import Imu

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]


@dataclass(frozen=True)
class Dataset:
    """One run, aligned to a uniform grid. Columns carry the names and SI units of the CSV contract.

    A sample that was not measured is NaN in its column: a gap stays a gap.
    """

    name: str
    """What a person calls the run: the file's name."""
    rate_hz: float
    """Samples per second of the grid."""
    time_s: FloatArray
    """(n,) grid times [s], uniform, on the recorder's clock."""
    columns: Mapping[str, FloatArray]
    """Column name (`q2_rad`, `tau2_nm`, ...) to values, each (n,)."""
    clock_bound_s: float = 0.0
    """How far the time line of the IMU, without one the pivot sensor's, may be off the controller's [s]; 0 where all
    share one clock."""
    averaged: float = 1.0
    """Samples of its file whose mean is one of the grid."""
    damage: tuple[Damage, ...] = ()
    """Ways in which its file is not what was recorded; empty for a whole one."""
    flags: tuple[Flag, ...] = ()
    """What in it cannot be true of one IMU on one leg."""
    readings: tuple[ReadingFault, ...] = ()
    """Readings that no device can give, and what was done with them."""
    steps: Steps | None = None
    """The touchdowns by which a walker's run was cut."""
    recorded_on: Rig | None = None
    """The rig file that a native run holds."""
    imu: Imu | None = None
    """Settings of the IMU that recorded it, by which its readings have an age."""
    torque_delay_s: float = 0.0
    """By how much its torques were moved, from when they were measured to when they act [s]."""
    imu_age_s: float | None = None
    """By how much the readings of its IMU were moved, from their stamps to when they were true, of several the largest
    [s]; None: they are where they are stamped."""
    loops: Mapping[int, Loop] = field(default_factory=dict)
    """Joint, from 1, to the position loop that it follows."""
    by_law: tuple[int, ...] = ()
    """Joints, from 1, whose input was not measured: it is what their loop gives."""

    def __post_init__(self) -> None:
        n = self.time_s.shape[0]
        for name, values in self.columns.items():
            if values.shape != (n,):
                raise ValueError(f"column {name} has shape {values.shape}, the grid has {n} samples")

    @property
    def told(self) -> tuple[Flag, ...]:
        """Its flags, and one for each fault of its readings."""
        return (*self.flags, *(Flag("readings", str(fault)) for fault in self.readings))

    def __len__(self) -> int:
        return int(self.time_s.shape[0])

    def __contains__(self, column: str) -> bool:
        return column in self.columns

    def __getitem__(self, column: str) -> FloatArray:
        return self.columns[column]

    @property
    def dt_s(self) -> float:
        """Grid step [s]."""
        return 1.0 / self.rate_hz

    def gap(self, names: list[str] | None = None) -> BoolArray:
        """(n,) True where any of the columns `names` (default: all) has no sample."""
        wanted = list(self.columns) if names is None else names
        missing = np.zeros(len(self), dtype=bool)
        for name in wanted:
            missing |= ~np.isfinite(self.columns[name])
        return missing

    def segments(self, names: list[str] | None = None, min_samples: int = 20) -> list[slice]:
        """Segments of at least `min_samples` samples without a gap in `names`, in order of time."""
        present = np.concatenate(([False], ~self.gap(names), [False])).astype(np.int8)
        edges = np.diff(present)
        starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
        return [slice(int(a), int(b)) for a, b in zip(starts, stops) if b - a >= min_samples]

    def part(self, where: slice) -> Self:
        """The samples of `where` as a data set of their own."""
        columns = {name: values[where] for name, values in self.columns.items()}
        return replace(self, time_s=self.time_s[where], columns=columns)
