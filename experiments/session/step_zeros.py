"""Runs in which an encoder's zero may have changed: the equation of motion decides whether, and which part is right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import Dataset, ReadingFault
from estimator import FIT_ERRORS, FitOptions
from estimator.calibration import as_it_is
from estimator.model import Mechanism

BETTER = 1.2
"""A zero has changed where slow least squares leaves so many times less without the steps. The part behind them has
the right one where it leaves so many times less again."""


def with_step_zeros(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> tuple[Dataset, ...]:
    """The runs, those with steps of an encoder's zero joined at the zero under which gravity explains the torque.

    A step that the equation of motion takes for motion stays.
    """
    return tuple(_decided(data, mechanism, options) for data in datasets)


def _decided(data: Dataset, mechanism: Mechanism, options: FitOptions) -> Dataset:
    for column in {fault.column for fault in data.readings if fault.what == "stepped"} & set(data.columns):
        own = [fault for fault in data.readings if (fault.column, fault.what) == (column, "stepped")]
        joined = data[column].copy()
        for step in own:
            joined[data.time_s > step.time_s - 0.5 / data.rate_hz] -= step.size
            joined[np.abs(data.time_s - step.time_s) < 0.5 * (data.averaged > 1.0) / data.rate_hz] = np.nan
        total = sum(step.size for step in own)
        tried = [replace(data, columns={**data.columns, column: q}) for q in (data[column], joined, joined + total)]
        try:
            with np.errstate(all="ignore"):
                as_read, before, behind = (as_it_is([one], mechanism, options) for one in tried)
        except (*FIT_ERRORS, ValueError):  # too short to ask
            continue
        last = BETTER * behind.left < before.left or bool(before.faults and not behind.faults)
        best = behind if last else before
        if BETTER * best.left < as_read.left or (as_read.faults and not best.faults):
            right = "behind them" if last else "before them"
            faults = tuple(_joined(fault, right) if fault in own else fault for fault in data.readings)
            data = replace(tried[1 + last], readings=faults)
    return data


def _joined(step: ReadingFault, right: str) -> ReadingFault:
    return replace(step, done="joined", text=f"{step.text}; by the equation of motion the zero changed, and the one "
                   f"{right} is right")
