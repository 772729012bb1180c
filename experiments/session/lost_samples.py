"""Readings that the motion shows to be wrong: of a sensor that lost or doubled samples, and of a start with a hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import Dataset, ReadingFault
from estimator import FIT_ERRORS, FitOptions, parallel_map
from estimator.calibration import find_lost, lost_text, unexplained_start, without_loss
from estimator.model import Mechanism
from estimator.numerics import load_compiler
from estimator.signals import is_plain

MOST_PLACES = 3
"""Places in one run that are corrected."""


def with_lost_samples(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, workers: int = 1
                      ) -> tuple[Dataset, ...]:
    """The runs, those with lost or doubled samples corrected by `workers`, each place a fault of the readings.

    Not where samples were averaged: what one channel lost is no whole number of those. (On a real record, averaged from
    500 to 25 samples a second, three samples were moved that were never lost; none on the record's own grid.)
    """
    if not is_plain(mechanism, options):
        return tuple(datasets)
    load_compiler()  # once for all processes
    return tuple(parallel_map(lambda k: datasets[k] if any(flag.kind == "grid" for flag in datasets[k].flags) else
                              _corrected(datasets[k], mechanism, options), len(datasets), workers))


def without_starts(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> tuple[Dataset, ...]:
    """The runs without starts that the mechanism cannot explain."""
    return tuple(_without_start(data, mechanism, options) for data in datasets)


def _without_start(data: Dataset, mechanism: Mechanism, options: FitOptions) -> Dataset:
    try:
        with np.errstate(all="ignore"):
            count = unexplained_start(data, mechanism, options)
    except (*FIT_ERRORS, ValueError):  # too short, or not a number in it
        return data
    if not count:
        return data
    text = (f"the first {count / data.rate_hz:.2g} s (rows 1 to {count}) are no motion of the mechanism alone: a hand "
            "or a brake holds it, or a loop switches on")
    late = np.arange(len(data)) >= count
    return replace(data, columns={name: np.where(late, x, np.nan) for name, x in data.columns.items()}, readings=(
        *data.readings, ReadingFault("every column", "start", ((1, count),), count / data.rate_hz, "left_out", text)))


def _corrected(data: Dataset, mechanism: Mechanism, options: FitOptions) -> Dataset:
    for _ in range(MOST_PLACES):
        try:
            with np.errstate(all="ignore"):
                lost = find_lost(data, mechanism, options)
        except (*FIT_ERRORS, ValueError):  # too short, or not a number in it
            return data
        if lost is None:
            return data
        text = lost_text(lost, float(data.time_s[lost.row]))
        row = lost.row + 1
        faults = tuple(ReadingFault(column, "lost", ((row, row),), float(lost.samples), "joined", text)
                       for column in lost.columns)
        data = replace(without_loss(data, lost), readings=(*data.readings, *faults))
    return data
