"""Axes, units and signs of an IMU by what they must add up to, and what all guesses by physics share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Literal, NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import binary_opening

from daq import Column, Dataset, FloatArray
from estimator.calibration import CLEAR, TRIED, ImuReading, imu_readings
from estimator.signals import IMU_COLUMNS, lowpass
from experiments.exchange.units import factor, unit_in_name

SLOW_HZ = 0.3
"""Below this the accelerometer gives the pivot's angle, above it the gyro's integral."""
FAST_HZ = 8.0
BRIDGED_S = 0.05
"""A longer gap is no straight line."""
Sign = Literal[1, -1]
SIGNS: tuple[Sign, ...] = (1, -1)
NOT_SURE = "NOT SURE: "
EXPLAINS = 0.5
"""What leaves a larger share is no explanation. Right units and signs leave 11 to 35 % of the torque of a moving leg
(up to two thirds of one that hardly moves), an absolute angle for a relative one about 56 %, a motor's angle 81 %."""


class Found(NamedTuple):
    columns: dict[str, Column]
    notes: dict[str, str]
    warnings: list[str]
    unexplained: list[str]
    """What no unit and sign makes fit: whatever stands in `columns` for it is not to be used."""
    check: tuple[FloatArray, FloatArray]
    """(n,) measured, and as physics makes it of the others."""
    pose: FloatArray | None = None
    """(n,) the first link's angle as the IMU shows it [rad]"""
    left: float = 0.0
    """The share of what is to be explained that the best reading leaves."""


@dataclass(frozen=True)
class Way:
    """One way to read columns, and what it leaves."""

    left: float
    """Residual as a share of what is to be explained."""


@dataclass(frozen=True)
class _Turning(Way):
    """The gyro read against one axis of the accelerometer."""

    unit: str
    sign: Sign
    side: str
    """The axis across the link."""
    read: ImuReading

    def __str__(self) -> str:
        return f"{self.unit}, sign {self.sign:+d}"


def find_imu(rate_hz: float, gyro: Mapping[str, FloatArray], accel: Mapping[str, FloatArray], gravity: float) -> Found:
    """Axes, units and signs of gyro and accelerometer, each axis (n,) as the file has it."""
    gyro, accel = ({name: filled(values) for name, values in axes.items()} for axes in (gyro, accel))
    turning = max(gyro, key=lambda name: float(np.std(gyro[name])))
    along = max(accel, key=lambda name: abs(float(np.median(accel[name]))))
    length = float(np.median(np.sqrt(sum(values**2 for values in accel.values()))))
    accel_unit, to_mps2 = min(TRIED["mps2"].items(), key=lambda one: abs(np.log(max(length, 1e-12) * one[1] / gravity)))
    out_sign = -int(np.sign(np.median(accel[along])))
    a_y = out_sign * to_mps2 * accel[along]
    units = [(unit or "rad/s", sign, sign * scale) for (unit, scale), sign in product(TRIED["radps"].items(), SIGNS)]
    ways = [(np.eye(2), turned) for turned in (0.0, *(turned for *_, turned in units))]
    sides = {side: to_mps2 * values for side, values in accel.items() if side != along}
    found, time_s = [], np.arange(len(a_y)) / rate_hz
    for side, a_x in sides.items():
        run = Dataset(side, rate_hz, time_s, dict(zip(IMU_COLUMNS, (gyro[turning], a_x, a_y))))
        still, *read = imu_readings([run], ways, 0.0, hangs=True)
        found += [_Turning(one.left / still.left, unit, sign, side, one) for (unit, sign, _), one in zip(units, read)]
    first, second, *_ = sorted(found, key=lambda way: way.left)
    warnings, unexplained = [], []
    weight = first.read.gravity / to_mps2
    heavy = abs(first.read.gravity / gravity - 1.0) <= 0.2
    if not heavy:
        unexplained.append(f"the accelerometer shows a gravity of {weight:.4g}, which is none in m/s2, g, mg or mm/s2: "
                           "it may be in counts, or have gravity taken off")
    said = unit_in_name(along, "accel_y_mps2")
    if heavy and said and not _same(said, accel_unit, "accel_y_mps2"):
        warnings.append(f"the name of {along!r} says {said}, but its gravity is that of {accel_unit or 'm/s2'}")
    lever_m = first.read.lever_arm
    check, pose = _tangential(sides[first.side], a_y, first.read.factor * gyro[turning], rate_hz, gravity, lever_m)
    unit, said = first.unit, unit_in_name(turning, "gyro_radps")
    fits = f"in {unit}, sign {first.sign:+d}, its integral explains accel_x, all but {100 * first.left:.1f} %"
    known, close = first.left <= EXPLAINS and heavy, close_call("the gyro's unit and sign", "accel_x", first, second)
    if first.left > EXPLAINS:
        unexplained.append(f"no unit and sign of {turning!r} explains the accelerometer (the best leaves "
                           f"{100 * first.left:.0f} % of {first.side!r}): another axis or sensor, an IMU that is "
                           "turned against the link, or a time in another unit")
    else:
        warnings += close
    if known and said and not _same(said, first.unit, "gyro_radps"):
        warnings.append(f"the name of {turning!r} says {said}, but {fits}: {unit} is taken")
    columns = {"gyro_radps": Column(name=turning, unit=unit.removeprefix("rad/s"), sign=first.sign),
               "accel_x_mps2": Column(name=first.side, unit=accel_unit),
               "accel_y_mps2": Column(name=along, unit=accel_unit, sign=1 if out_sign > 0 else -1)}
    notes = {
        "gyro_radps": (f"{NOT_SURE * bool(close)}the axis that turns most; {fits} (next best: "
                       f"{100 * second.left:.0f} %)" if known else
                       "NOT KNOWN: the axis that turns most, but it does not fit the accelerometer"),
        "accel_x_mps2": (f"across the link, in the plane of motion; the IMU's lever arm would be {lever_m:.3f} m"
                         if known else "NOT KNOWN: it does not fit the gyro"),
        "accel_y_mps2": (f"the axis that carries gravity, {weight:.4g} {accel_unit or 'm/s2'}"
                         if heavy else f"NOT KNOWN: no gravity in it, {weight:.4g}")}
    return Found(columns, notes, warnings, unexplained, check, pose)


def close_call(whose: str, what: str, first: Way, second: Way) -> list[str]:
    """A warning where the runner-up leaves little more than the first of `what`; else none."""
    if second.left >= CLEAR * first.left:
        return []
    return [f"{whose} are a close call: ({first}) leaves {100 * first.left:.0f} % of {what}, ({second}) "
            f"{100 * second.left:.0f} %; look at the plot, and set them by hand if they are others"]


def _same(one: str, other: str, column: str) -> bool:
    """Two names of one unit."""
    return bool(np.isclose(factor(one, column, ""), factor(other, column, "")))


def filled(x: FloatArray) -> FloatArray:
    """(n,) with straight lines over what is missing."""
    known = np.isfinite(x)
    return x if known.all() else np.interp(np.arange(x.size), np.flatnonzero(known), x[known])


def bridged(x: FloatArray, rate_hz: float) -> FloatArray:
    """(n,) with straight lines over short gaps."""
    return np.where(binary_opening(~np.isfinite(x), np.ones(round(BRIDGED_S * rate_hz) + 1, bool)), np.nan, filled(x))


def scale_warnings(name: str, torque: Column) -> list[str]:
    """The warning that the scale of a torque in amperes, or without a unit, does not show; none for another unit."""
    if torque.unit and torque.unit.lower() not in ("a", "ma"):
        return []
    return [f"the scale of {name} does not show: set scale to N m per {torque.unit or 'unit'} of {torque.name!r}"
            + ("" if torque.unit else " if it is not in N m at the joint")]


def smooth(x: FloatArray, rate_hz: float) -> FloatArray:
    """(n, ...) without gaps and without what is faster than a record's motion."""
    return lowpass(filled(x), min(FAST_HZ, 0.2 * rate_hz), rate_hz)


def _band(x: FloatArray, rate_hz: float) -> FloatArray:
    """(n,) without what drifts and what only rings."""
    return smooth(x, rate_hz) - lowpass(x, SLOW_HZ, rate_hz)


def _tangential(a_x: FloatArray, a_y: FloatArray, omega: FloatArray, rate_hz: float, gravity: float, lever_m: float
                ) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """accel_x (n,) band-passed and the same as gyro and gravity make it, and the angle."""
    turned = cumulative_trapezoid(omega - omega.mean(), dx=1.0 / rate_hz, initial=0)
    swing = lever_m * np.gradient(omega, 1.0 / rate_hz)
    tilt = np.unwrap(np.arctan2(a_x - swing, -a_y - lever_m * omega**2))
    q1 = turned - lowpass(turned, SLOW_HZ, rate_hz) + lowpass(tilt, SLOW_HZ, rate_hz)
    return (_band(a_x, rate_hz), _band(swing + gravity * np.sin(q1), rate_hz)), q1
