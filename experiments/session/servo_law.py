"""A servo's position law in place of a torque channel: torque from the command and the encoder's reading.

The law uses the quantised reading, as the servo's controller does. The fit estimates the deviation of the real torque
as torque noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daq import Dataset, FloatArray, Rig, Servo
from estimator.signals import lowpass


def needs_law(data: Dataset, rig: Rig) -> bool:
    """Whether the rig declares a servo whose input the run does not have."""
    return rig.servo is not None and bool(_joints(data, rig))


def with_law(data: Dataset, rig: Rig, servo: Servo) -> Dataset:
    """`data` with the input by the law of `servo` of every driven joint that has a command and no input."""
    driven = sorted(rig.mechanism.actuated)
    columns = dict(data.columns)
    for j in _joints(data, rig):
        gain, damping, limit = (_of(value, driven.index(j)) for value in (servo.gain, servo.damping, servo.limit))
        q = data[f"q{j}_rad"]
        law = (1.0 if gain is None else gain) * (data[f"q{j}_cmd_rad"] - q)
        if damping:
            law = law - damping * _rate(data, f"q{j}_rad", rig)
        most = 1.0 if limit is None and rig.mechanism.input == "voltage" else limit
        columns[_input(rig, j)] = law if most is None or gain is None else np.clip(law, -most, most)
    return replace(data, columns=columns)


def _joints(data: Dataset, rig: Rig) -> list[int]:
    return [j for j in rig.mechanism.actuated
            if _input(rig, j) not in data and f"q{j}_cmd_rad" in data and f"q{j}_rad" in data]


def _input(rig: Rig, joint: int) -> str:
    return "duty" if rig.mechanism.input == "voltage" else f"tau{joint}_nm"


def _of(value: float | tuple[float, ...] | None, at: int) -> float | None:
    return value[at] if isinstance(value, tuple) else value


def _rate(data: Dataset, column: str, rig: Rig) -> FloatArray:
    """(N,) slow rate [rad/s] of an angle, NaN in its gaps: what a servo differences is noise beyond."""
    cutoff = rig.filter.cutoff_hz or min(10.0, 0.1 * data.rate_hz)
    out = np.full(len(data), np.nan)
    for where in data.segments([column]):
        slow = lowpass(data[column][where], cutoff, data.rate_hz, rig.filter.order)
        out[where] = np.gradient(slow, 1.0 / data.rate_hz)
    return out
