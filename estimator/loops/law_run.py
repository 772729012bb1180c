"""`LawRun`: input, command and angle of one joint in one run, where its position loop was at work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq import BoolArray, Dataset, FloatArray
from estimator.model import Mechanism
from estimator.signals import angle_column, command_columns, torque_column

DUTY = "duty"
"""Column of what a loop gives a motor on voltage."""
LIMIT = 0.95
"""Share of the largest input from which on a loop may be at its limit."""
OFF, NOTHING = 5, 1e-2
"""Samples without any input from which on the loop was off; none is less than this share of the largest."""
LEAST = 50
"""Samples of a run that say something of a law."""


@dataclass(frozen=True)
class LawRun:
    """Arrays (N,) without gaps."""

    name: str
    rate_hz: float
    input: FloatArray
    """As measured: torque [N m], of a motor on voltage its duty"""
    command: FloatArray
    """[rad]"""
    angle: FloatArray
    """[rad]"""
    used: BoolArray
    """Samples at which the loop was on and below its limit"""

    @property
    def error(self) -> FloatArray:
        """(N,) command less angle [rad]."""
        return self.command - self.angle

    @property
    def span(self) -> float:
        """Sum of squares of the input about its mean."""
        return float(np.sum((self.input[self.used] - self.input[self.used].mean()) ** 2))


def input_column(data: Dataset, mechanism: Mechanism, joint: int) -> str:
    """Column of what the loop of a joint (0-based) gave, as it was measured."""
    return DUTY if mechanism.force_unit == "V" and DUTY in data else torque_column(mechanism, joint)


def law_runs(datasets: Sequence[Dataset], mechanism: Mechanism, joint: int) -> list[LawRun]:
    """The runs that show the law of a joint (0-based): input, command and angle were all measured."""
    found = []
    for data in datasets:
        columns = [input_column(data, mechanism, joint), command_columns(joint)[0], angle_column(mechanism, joint)]
        if joint + 1 in data.by_law or not all(column in data for column in columns):
            continue
        for where in data.segments(columns, LEAST):
            values = [data[column][where] for column in columns]
            used = _at_work(values[0])
            if used.sum() >= LEAST and np.ptp(values[0][used]) > 0.0 and np.ptp(values[1][used]) > 0.0:
                found.append(LawRun(data.name, data.rate_hz, values[0], values[1], values[2], used))
    return found


def _at_work(given: FloatArray) -> BoolArray:
    """(N,) samples between the limits, and not where there is no input for a while; nor their neighbours, of
    which an average may have part."""
    size = np.abs(given) / np.abs(given).max()
    out = size >= LIMIT
    zero = np.concatenate([[0], (size < NOTHING).astype(np.int8), [0]])
    edges = np.diff(zero)
    for begin, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)):
        out[begin:end] |= end - begin >= OFF
    near = out.copy()
    near[1:] |= out[:-1]
    near[:-1] |= out[1:]
    return ~near
