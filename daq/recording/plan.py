"""`Plan`: the torque to be commanded over time."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daq.dataset import FloatArray
from daq.errors import InputError
from daq.files import write_file
from daq.rig import Rig
from daq.rig_devices import ControllerDevice
from daq.runs import read_csv
from drivers import Drive, Lsm9ds1, hello_of

COLUMN = "tau2_cmd_nm"
SLEW_S = 0.01
"""Window of a plan's largest slew rate [s]; to a leg a shorter ramp is a step."""


@dataclass(frozen=True)
class Plan:
    """Knee torque over time, held from each time to the next."""

    time_s: FloatArray
    """(n,) strictly increasing [s]; the first is the start of the run."""
    torque_nm: FloatArray
    """(n,) [N m]; the last holds for one step more."""

    def __post_init__(self) -> None:
        if self.time_s.shape != self.torque_nm.shape or self.time_s.ndim != 1 or self.time_s.size < 2:
            raise ValueError("a plan needs two or more times and as many torques")
        if not (np.isfinite(self.time_s).all() and np.isfinite(self.torque_nm).all()):
            raise ValueError("a plan holds finite numbers only")
        if (np.diff(self.time_s) <= 0).any():
            raise ValueError("a plan's times increase")

    @property
    def duration_s(self) -> float:
        """Duration from the first command to the end of the last one's hold [s]."""
        return float(self.time_s[-1] - self.time_s[0] + np.median(np.diff(self.time_s)))

    @property
    def offset_ns(self) -> list[int]:
        """When each command is due, after the start [ns]."""
        return [int(ns) for ns in np.rint((self.time_s - self.time_s[0]) * 1e9)]

    @property
    def peak_nm(self) -> float:
        """Largest magnitude commanded [N m]."""
        return float(np.abs(self.torque_nm).max())

    @property
    def slew_nmps(self) -> float:
        """Largest slew rate [N m/s] over 10 ms, from zero before the first command and to zero after the last."""
        torque = np.concatenate(([0.0], self.torque_nm, [0.0]))
        times = np.concatenate(([self.time_s[0] - 1.0], self.time_s, [self.time_s[0] + self.duration_s]))
        held = np.searchsorted(times, times - SLEW_S * (1 - 1e-6), side="right") - 1  # what was asked for 10 ms before
        before = np.minimum(np.maximum(held, 0), np.maximum(np.arange(times.size) - 1, 0))
        steps = np.maximum(np.abs(torque - torque[before]), np.abs(np.diff(torque, prepend=0.0)))
        return float(steps.max()) / SLEW_S

    def text(self) -> str:
        """The plan as CSV with header `time_s,tau2_cmd_nm`."""
        out = io.StringIO()
        np.savetxt(out, np.column_stack((self.time_s, self.torque_nm)), fmt=["%.9f", "%.9g"], delimiter=",",
                   header=f"time_s,{COLUMN}", comments="")
        return out.getvalue()


def read_plan(path: Path | str, measured: Sequence[str] = ()) -> Plan:
    """Plan from CSV, checked like a run; of a run without commands the first of its columns `measured`.

    Raises `InputError` naming file, line and column.
    """
    table = read_csv(path, min_samples=2)
    column = next((name for name in (COLUMN, *measured) if name in table.columns), None)
    if column is None:
        raise InputError(f"{path}, line 1", f"column {COLUMN} is missing", "add the torque to command in N m")
    return Plan(table.time_s, table.columns[column])


def write_plan(plan: Plan, path: Path | str) -> None:
    """Write `plan` as CSV. Raises `InputError` where the place cannot be written."""
    write_file(path, plan.text().encode())


def check_plan(plan: Plan, rig: Rig, controller: Drive) -> None:
    """Raises `InputError` when the plan or rig.toml asks for more than rig and firmware allow."""
    hello = hello_of(controller)
    limits = {"limits.torque_nm of the rig": rig.limits.torque_nm, "the firmware's limit": hello.torque_limit_nm}
    for name, bound in limits.items():
        if plan.peak_nm > bound:
            what = f"asks for {plan.peak_nm:g} N m, {name} is {bound:g} N m"
            raise InputError("plan", what, "scale the plan down")
    for what, value, key in (("changes by", plan.slew_nmps, "slew_nmps"), ("lasts", plan.duration_s, "duration_s")):
        bound = getattr(rig.limits, key)
        if value > bound * (1 + 1e-9):
            unit, remedy = ("N m/s", "make its steps smaller") if key == "slew_nmps" else ("s", "split the plan")
            raise InputError("plan", f"{what} {value:g} {unit}, limits.{key} of the rig is {bound:g} {unit}",
                             f"{remedy}, or raise the limit if the leg can stand it")
    watchdog_ms = (rig.devices.controller or ControllerDevice()).watchdog_ms
    if watchdog_ms > hello.watchdog_ms:
        raise InputError("rig", f"devices.controller.watchdog_ms is {watchdog_ms}, the firmware allows "
                                f"{hello.watchdog_ms}", "lower it")


def check_drive(rig: Rig, controller: Drive) -> None:
    """Raises `InputError` where the drive cannot make a check that the rig file does not give up."""
    if not controller.capabilities.knee_twice and "encoder_s" not in rig.limits.unchecked:
        raise InputError("rig", "this drive reads the knee by one sensor, so limits.encoder_s cannot be checked",
                         'say so: [limits] unchecked = ["encoder_s"], see docs/safety.md')


def check_gyro(rig: Rig, imu: Lsm9ds1 | None) -> None:
    """Raises `InputError` when the gyro's range cannot show the limit of the pivot's speed."""
    if imu is None:
        return
    reach = math.radians(imu.config.gyro_range_dps)
    if rig.limits.q1_speed_radps > reach:
        what = f"limits.q1_speed_radps is {rig.limits.q1_speed_radps:g} rad/s, a gyro of " \
               f"{imu.config.gyro_range_dps} dps shows up to {reach:.3g}"
        raise InputError("rig", what, "lower the limit, or set a larger devices.imu.gyro_range_dps")
