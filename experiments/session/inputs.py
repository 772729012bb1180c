"""The input that a mechanism is driven by, made of the columns that a run has."""

from __future__ import annotations

from dataclasses import replace

from daq import Dataset, Rig, Steps
from daq.runs import VOLTAGE
from estimator.calibration import DistanceMeter, angle_record
from estimator.signals import STANCE, cut_steps
from experiments.session.servo_law import with_law


def driven(data: Dataset, rig: Rig) -> Dataset:
    """`data` with the input that the mechanism is driven by: for a servo on voltage, duty times volts, for one without
    a torque channel what its law gives; with the absolute angle that a distance meter shows; and a walker's cut into
    steps.

    A voltage is in the column `voltage1_v` [V]; every parameter is then in volt units. A run that has its input is
    returned with it as it is. Raises `FitError` where a walker's steps cannot be told.
    """
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


def walked(data: Dataset, open_s: float) -> Dataset:
    """A walker's record by role, with its steps; one that has been cut is returned as it is. Raises `FitError`."""
    if data.steps is not None:
        return data
    cut, found = cut_steps(data, open_s)
    within = None if STANCE in data else float(found.open_s.max())
    return replace(cut, steps=Steps(int(found.time_s.size), within))
