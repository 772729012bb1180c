"""`without_motor_off`: the input of a motor where it was switched off is not known, and not 0 V."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daq import BoolArray, Dataset, Flag, Rig
from daq.runs import ENABLED, VOLTAGE

ON = 0.99
"""Share of a sample from which on a motor counts as switched on: between samples the column is interpolated."""
LONG_S, MOVED = 0.25, 0.1
"""Segment of duty zero that is asked about: its least length, and least range of the angle [rad] within it."""
BY_MOTOR = ("duty", VOLTAGE, "q1_cmd_rad")
"""Columns that act through a motor that is on, and do nothing while it is off."""


def without_motor_off(data: Dataset, rig: Rig) -> Dataset:
    """`data` with gaps in duty, voltage and command of the motor where the column `torque_enable` has it off.

    Both terminals of such a motor are open: no current flows, and its back-EMF does not brake as at 0 V. Without the
    column, and with `input = "voltage"`, a flag tells of a duty of exactly zero while the joint moves.
    """
    if 1 not in rig.mechanism.actuated or rig.mechanism.model != "joint1":
        return data
    if ENABLED not in data:
        return _flagged(data, _asked(data)) if rig.mechanism.input == "voltage" else data
    off = ~(data[ENABLED] >= ON)
    if not off.any():
        return data
    columns = {name: np.where(off, np.nan, data[name]) for name in BY_MOTOR if name in data}
    text = (f"has its motor off for {off.sum() / data.rate_hz:.2g} s by {ENABLED}: an open motor does not brake, so "
            "its input is left out there")
    return _flagged(replace(data, columns={**data.columns, **columns}), text)


def _flagged(data: Dataset, text: str) -> Dataset:
    flag = Flag("readings", text)
    return replace(data, flags=(*data.flags, flag)) if text and flag not in data.flags else data


def _asked(data: Dataset) -> str:
    """What is asked of the longest segment of duty zero in which the joint moves; empty without one."""
    if not {"duty", "q1_rad"} <= set(data.columns):
        return ""
    longest = max(_segments(data["duty"] == 0.0), key=lambda one: one.stop - one.start, default=slice(0, 0))
    length = (longest.stop - longest.start) / data.rate_hz
    begin = longest.start / data.rate_hz
    if length < LONG_S or np.ptp(np.nan_to_num(data["q1_rad"][longest])) < MOVED:
        return ""
    return (f"has duty 0 for {length:.2g} s from {begin:.3g} s on while the joint moves: read as 0 V, which brakes; if "
            f"the motor was off, add {ENABLED} (1 on, 0 off)")


def _segments(where: BoolArray) -> list[slice]:
    edges = np.diff(np.concatenate(([False], where, [False])).astype(np.int8))
    return [slice(int(a), int(b)) for a, b in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1))]
