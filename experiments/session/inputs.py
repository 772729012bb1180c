"""The input that a mechanism is driven by, made of the columns that a run has."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from daq import Dataset, FloatArray, Rig, Steps
from daq.runs import VOLTAGE
from estimator.calibration import DistanceMeter, angle_record
from estimator.signals import STANCE, added_by_delay, cut_steps, imu_columns, shifted, slow_part
from experiments.session.motor_off import without_motor_off
from experiments.session.servo_law import with_law

TORQUE = re.compile(r"tau\d+_nm?")
"""Columns that drive a mechanism."""
AGES = 2.0
"""Standard deviations of an IMU's nominal age within which it may be: about its 95 % interval."""


def driven(data: Dataset, rig: Rig) -> Dataset:
    """`data` with the input that the mechanism is driven by: for a servo on voltage, duty times volts, for one without
    a torque channel what its law gives, and a gap where the motor is off; with the absolute angle that a distance meter
    shows; and a walker's cut into steps. A torque is where `[timing]` says that it acts, an IMU's reading where
    `[imu]` or the recorder says that it was true.

    A voltage is in the column `voltage1_v` [V]; every parameter is then in volt units. A run that has its input is
    returned with it as it is. Raises `FitError` where a walker's steps cannot be told.
    """
    if rig.timing.torque_delay_s is not None and not data.torque_delay_s:
        data = with_delay(data, rig.timing.torque_delay_s[0])
    data = with_imu_age(data, rig)
    if rig.walker is not None:
        return walked(data, rig.walker.touchdown_s)
    if rig.distance_meter is not None and "distance_m" in data:
        d = rig.distance_meter
        data = angle_record(data, DistanceMeter(d.mount_m, d.gamma_rad, d.sigma_m, d.sigma_per_m), d.upright_rad)
    data = without_motor_off(data, rig)
    if rig.servo is not None and rig.servo.gain is not None:
        data = with_law(data, rig, rig.servo)
    if rig.mechanism.input != "voltage" or VOLTAGE in data or "duty" not in data:
        return data
    return replace(data, columns={**data.columns, VOLTAGE: data["duty"] * data["volts"]})


def with_delay(data: Dataset, delay_s: float) -> Dataset:
    """`data` with its torques [N m] and forces [N] as they act, `delay_s` [s] after their stamps.

    Samples whose torque was measured before the run began are gaps.
    """
    samples = delay_s * data.rate_hz

    def late(y: FloatArray) -> FloatArray:
        return y + added_by_delay(y, slow_part(y, data.rate_hz), samples)

    names = [name for name in data.columns if TORQUE.fullmatch(name)]
    return replace(data, columns={**data.columns, **_moved(data, names, samples, late)}, torque_delay_s=delay_s)


def with_imu_age(data: Dataset, rig: Rig) -> Dataset:
    """`data` with the readings of its IMUs when they were true: earlier than their stamps by the nominal ages of gyro
    and accelerometer, which `[imu]` gives, else the recorder.

    Readings that were taken after the run's end are gaps. What may remain, twice the age's standard deviation, is added
    to the bound of its clocks. Returned as it is where neither gives an age, or the readings are in place.
    """
    imus = {k: imu for k, imu in enumerate(rig.told_by(data.imu).imus) if imu_columns(k)[0] in data}
    ages = [(name, age.mean_s) for k, imu in imus.items() if imu.ages is not None
            for name, age in zip(imu_columns(k), (imu.ages[0], imu.ages[1], imu.ages[1]), strict=True) if name in data]
    if data.imu_age_s is not None or not ages:
        return data
    columns = dict(data.columns)
    for name, age_s in ages:
        early = -age_s * data.rate_hz
        columns |= _moved(data, [name], early, partial(shifted, samples=early))
    return replace(data, columns=columns, imu_age_s=max(age_s for _, age_s in ages),
                   clock_bound_s=data.clock_bound_s + AGES * max(imu.age_std_s for imu in imus.values()))


def _moved(data: Dataset, names: Sequence[str], samples: float, move: Callable[[FloatArray], FloatArray]
           ) -> dict[str, FloatArray]:
    """Columns with each segment moved by so many samples; what comes from beyond its ends is a gap."""
    found = {}
    lost = int(np.ceil(round(abs(samples), 6)))
    for name in names:
        found[name] = np.full(len(data), np.nan)
        for where in data.segments([name]):
            y = move(data[name][where])
            own = slice(min(lost, len(y)), None) if samples > 0.0 else slice(None, max(len(y) - lost, 0))
            found[name][where][own] = y[own]
    return found


def walked(data: Dataset, open_s: float) -> Dataset:
    """A walker's record by role, with its steps; one that has been cut is returned as it is. Raises `FitError`."""
    if data.steps is not None:
        return data
    cut, found = cut_steps(data, open_s)
    within = None if STANCE in data else float(found.open_s.max())
    return replace(cut, steps=Steps(int(found.time_s.size), within))
