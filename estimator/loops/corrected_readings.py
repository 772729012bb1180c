"""`corrected_readings`: runs without the faults that the laws of their loops show in input, angle and command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import Dataset, FloatArray
from estimator.loops.law_check import LawCheck, check_law
from estimator.loops.law_fit import Found, corrected
from estimator.loops.law_run import DUTY, LawRun, input_column, law_runs
from estimator.model import Mechanism
from estimator.signals import angle_column, command_columns, torque_column


def law_checks(datasets: Sequence[Dataset], mechanism: Mechanism) -> list[LawCheck]:
    """One for each driven joint whose input, command and angle were measured in at least two runs."""
    checks = []
    for joint in mechanism.actuated:
        runs = law_runs(datasets, mechanism, joint)
        if len(runs) > 1:
            checks.append(check_law(runs, joint))
    return checks


def corrected_readings(datasets: Sequence[Dataset], mechanism: Mechanism, joint: int, faults: Found
                       ) -> tuple[Dataset, ...]:
    """The runs without those `faults` of a joint (0-based) that are in readings."""
    own = tuple((fault, size) for fault, size in faults if fault.in_readings)
    return tuple(_corrected(data, mechanism, joint, own) for data in datasets) if own else tuple(datasets)


def _corrected(data: Dataset, mechanism: Mechanism, joint: int, faults: Found) -> Dataset:
    given, told, angle = (input_column(data, mechanism, joint), command_columns(joint)[0],
                          angle_column(mechanism, joint))
    if given not in data or told not in data:
        return data
    columns = {name: data[name].copy() for name in (given, told, angle)}
    for where in data.segments([given, told, angle]):
        every = np.ones(where.stop - where.start, bool)
        run = corrected(LawRun(data.name, data.rate_hz, data[given][where], data[told][where], data[angle][where],
                               every), faults)
        for name, new in zip((given, told, angle), (run.input, run.command, run.angle)):
            columns[name][where] = new
    if given == DUTY and "volts" in data:
        columns[torque_column(mechanism, joint)] = columns[DUTY] * data["volts"]
    return replace(data, columns={**data.columns, **columns})


def volts_of(datasets: Sequence[Dataset]) -> float:
    """Mean supply [V] of the runs; 1 where none is logged."""
    known: list[FloatArray] = [data["volts"] for data in datasets if "volts" in data]
    return float(np.nanmean(np.concatenate(known))) if known else 1.0
