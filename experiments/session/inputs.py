"""The input that a mechanism is driven by, made of the columns that a run has."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
from scipy.ndimage import shift

from daq import Dataset, Rig, Steps
from daq.runs import VOLTAGE
from estimator.calibration import DistanceMeter, angle_record
from estimator.signals import STANCE, cut_steps, lowpass
from experiments.session.servo_law import with_law

TORQUE = re.compile(r"tau\d+_nm?")
"""Columns that drive a mechanism."""
SLOW_SHARE = 0.12
"""Of the rate, below which a torque's curve between samples is its own."""


def driven(data: Dataset, rig: Rig) -> Dataset:
    """`data` with the input that the mechanism is driven by: for a servo on voltage, duty times volts, for one without
    a torque channel what its law gives; with the absolute angle that a distance meter shows; and a walker's cut into
    steps. A torque is where `[timing]` says that it acts.

    A voltage is in the column `voltage1_v` [V]; every parameter is then in volt units. A run that has its input is
    returned with it as it is. Raises `FitError` where a walker's steps cannot be told.
    """
    if rig.timing.torque_delay_s is not None and not data.torque_delay_s:
        data = with_delay(data, rig.timing.torque_delay_s[0])
    if rig.walker is not None:
        return walked(data, rig.walker.touchdown_s)
    if rig.distance_meter is not None and "distance_m" in data:
        d = rig.distance_meter
        data = angle_record(data, DistanceMeter(d.mount_m, d.gamma_rad, d.sigma_m, d.sigma_per_m), d.upright_rad)
    if rig.servo is not None and rig.servo.gain is not None:
        data = with_law(data, rig, rig.servo)
    if rig.mechanism.input != "voltage" or VOLTAGE in data or "duty" not in data:
        return data
    return replace(data, columns={**data.columns, VOLTAGE: data["duty"] * data["volts"]})


def with_delay(data: Dataset, delay_s: float) -> Dataset:
    """`data` with its torques [N m] and forces [N] as they act, `delay_s` [s] after their stamps.

    Whole samples move exactly. By the part of a sample that remains only what is slow moves: between samples, noise
    would be averaged. Samples whose torque was measured before the run began are gaps.
    """
    whole = round(delay_s * data.rate_hz)
    part = delay_s * data.rate_hz - whole
    moved = {name: values for name, values in data.columns.items() if TORQUE.fullmatch(name)}
    for name, values in moved.items():
        late = np.full(len(data), np.nan)
        for where in data.segments([name]):
            y = values[where]
            slow = lowpass(y, SLOW_SHARE * data.rate_hz, data.rate_hz)
            y = y - slow + shift(slow, part, order=3, mode="nearest")
            first, last = max(whole, 0), min(len(y) + whole, len(y))
            late[where.start + first : where.start + last] = y[first - whole : last - whole]
        moved[name] = late
    return replace(data, columns={**data.columns, **moved}, torque_delay_s=delay_s)


def walked(data: Dataset, open_s: float) -> Dataset:
    """A walker's record by role, with its steps; one that has been cut is returned as it is. Raises `FitError`."""
    if data.steps is not None:
        return data
    cut, found = cut_steps(data, open_s)
    within = None if STANCE in data else float(found.open_s.max())
    return replace(cut, steps=Steps(int(found.time_s.size), within))
