"""Runs in which an encoder's zero has changed: the motion decides which part has the right one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import Dataset, Flag
from estimator import FitError, FitOptions
from estimator.calibration import as_it_is
from estimator.model import Mechanism

BETTER = 1.2
"""The part behind a step has the right zero where slow least squares then leaves so many times less."""


def with_step_zeros(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> tuple[Dataset, ...]:
    """The runs, those with a step of an encoder's zero moved to the zero under which gravity explains the torque.

    A look joins both parts at the zero of the first. An index that was found late makes the last one right.
    """
    return tuple(_decided(data, mechanism, options) for data in datasets)


def _decided(data: Dataset, mechanism: Mechanism, options: FitOptions) -> Dataset:
    steps = {fault.column: sum(other.size for other in data.readings if (other.column, other.what) == (
        fault.column, "stepped")) for fault in data.readings if fault.what == "stepped" and fault.column in data}
    for column, size in steps.items():
        moved = replace(data, columns={**data.columns, column: data[column] + size})
        try:
            with np.errstate(all="ignore"):
                behind, before = (as_it_is([one], mechanism, options) for one in (moved, data))
        except (FitError, np.linalg.LinAlgError, ValueError):  # too short to ask
            continue
        if BETTER * behind.left < before.left or (before.faults and not behind.faults):
            told = f"{column} before its step is moved to the zero behind it: so slow torque is explained better"
            data = replace(moved, flags=(*data.flags, Flag("readings", told)))
    return data
