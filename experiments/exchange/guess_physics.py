"""Units and signs of a leg's signals by what they must add up to; `guess` says how."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import NamedTuple

import msgspec
import numpy as np

from daq import Column, Dataset, FloatArray
from estimator.model import leg2
from estimator.signals import lowpass
from experiments.exchange.units import DEGREE, TURN

SLOW_HZ = 0.3
"""Below this the accelerometer gives the pivot's angle, above it the gyro's integral."""
FAST_HZ = 8.0
ANGLE_UNITS = {"": 1.0, "deg": DEGREE, "turn": TURN}
RATE_UNITS = {"": 1.0, "deg/s": DEGREE, "turn/s": TURN}
ACCEL_UNITS = {"": 1.0, "g": 9.80665, "mg": 9.80665e-3}
CLEAR = 1.5
"""A guess whose runner-up leaves less than so many times its residual is called unsure."""


class Pose(NamedTuple):
    """The first link's motion as the IMU shows it."""

    q1: FloatArray
    """(n,) [rad]"""
    rate: FloatArray
    """(n,) [rad/s]"""


class Found(NamedTuple):
    columns: dict[str, Column]
    notes: dict[str, str]
    warnings: list[str]
    check: tuple[FloatArray, FloatArray]
    """(n,) measured, and as physics makes it of the others."""
    pose: Pose | None = None


def find_imu(rate_hz: float, gyro: Mapping[str, FloatArray], accel: Mapping[str, FloatArray], gravity: float) -> Found:
    """Axes, units and signs of gyro and accelerometer, each axis (n,) as the file has it."""
    turning = max(gyro, key=lambda name: float(np.nanstd(gyro[name])))
    along = max(accel, key=lambda name: abs(float(np.nanmedian(accel[name]))))
    length = float(np.nanmedian(np.sqrt(sum(values**2 for values in accel.values()))))
    accel_unit = min(ACCEL_UNITS, key=lambda unit: abs(np.log(max(length, 1e-12) * ACCEL_UNITS[unit] / gravity)))
    out_sign = -int(np.sign(np.nanmedian(accel[along])))
    warnings = []
    off = abs(length * ACCEL_UNITS[accel_unit] / gravity - 1.0)
    if off > 0.2:
        warnings.append(f"the accelerometer's median length is {length:.4g}, not gravity in m/s2, g or mg")
    a_y = out_sign * ACCEL_UNITS[accel_unit] * accel[along]
    best: list[tuple[float, str, str, int, FloatArray, FloatArray, Pose, float]] = []
    for side, (unit, scale), sign in product([name for name in accel if name != along], RATE_UNITS.items(), (1, -1)):
        a_x = ACCEL_UNITS[accel_unit] * accel[side]
        omega = sign * scale * gyro[turning]
        made, lever, pose = _tangential(a_x, a_y, omega, rate_hz, gravity)
        read = _band(a_x, rate_hz)
        share = float(np.sqrt(np.nanmean((read - made) ** 2) / max(float(np.nanmean(read**2)), 1e-30)))
        # the axis across the plane of motion is explained by nothing, and by nothing well: only a live axis counts
        live = float(np.nanstd(a_x)) / max(float(np.nanstd(np.stack(list(accel.values())), axis=1).max()), 1e-30)
        best.append((share / max(live, 1e-6), side, unit, sign, read, made, pose, lever))
    best.sort(key=lambda row: row[0])
    score, side, unit, sign, read, made, pose, lever = best[0]
    if best[1][0] < CLEAR * score:
        warnings.append(f"the gyro's unit and sign are a close call: {unit or 'rad/s'}, sign {sign}, leaves "
                        f"{100 * score:.0f} % of accel_x, {best[1][2] or 'rad/s'}, sign {best[1][3]}, "
                        f"{100 * best[1][0]:.0f} %")
    named = accel_unit or "m/s2"
    columns = {"gyro_radps": Column(name=turning, unit=unit, sign=1 if sign > 0 else -1),
               "accel_x_mps2": Column(name=side, unit=accel_unit),
               "accel_y_mps2": Column(name=along, unit=accel_unit, sign=1 if out_sign > 0 else -1)}
    notes = {"gyro_radps": f"the axis that turns most; in {unit or 'rad/s'}, sign {sign:+d}, its integral explains "
                           f"accel_x but for {100 * score:.1f} % (next best: {100 * best[1][0]:.0f} %)",
             "accel_x_mps2": f"across the link, in the plane of motion; the IMU's lever arm would be {lever:.3f} m",
             "accel_y_mps2": f"the axis that carries gravity, {length:.4g} {named} in the median"}
    return Found(columns, notes, warnings, (read, made), pose)


def _band(x: FloatArray, rate_hz: float) -> FloatArray:
    """Without what drifts and what only rings (n, ...)."""
    known = np.where(np.isfinite(x), x, np.nanmean(x, axis=0))
    return lowpass(known, min(FAST_HZ, 0.2 * rate_hz), rate_hz) - lowpass(known, SLOW_HZ, rate_hz)


def _tangential(a_x: FloatArray, a_y: FloatArray, omega: FloatArray, rate_hz: float, gravity: float
                ) -> tuple[FloatArray, float, Pose]:
    """accel_x (n,) as gyro and gravity make it, band-passed; the lever arm that fits it, not negative; the motion."""
    omega = np.where(np.isfinite(omega), omega, 0.0)
    turned = np.cumsum(omega - omega.mean()) / rate_hz
    tilt = np.unwrap(np.arctan2(np.where(np.isfinite(a_x), a_x, 0.0), np.where(np.isfinite(a_y), -a_y, gravity)))
    q1 = turned - lowpass(turned, SLOW_HZ, rate_hz) + lowpass(tilt, SLOW_HZ, rate_hz)
    swing, sine = (_band(x, rate_hz) for x in (np.gradient(omega, 1.0 / rate_hz), gravity * np.sin(q1)))
    lever = max(float(swing @ (_band(a_x, rate_hz) - sine) / max(float(swing @ swing), 1e-30)), 0.0)
    return lever * swing + sine, lever, Pose(q1, omega)


def find_knee(raw: Dataset, columns: Mapping[str, Column], pose: Pose | None, gravity: float) -> Found:
    """Unit and sign of the knee's angle, sign of its torque; with an encoder on the pivot, its unit too.

    `raw` has the columns as the file has them but for units that names state.
    """
    knee, torque = columns["q2_rad"], columns["tau2_nm"]
    angle, push = raw["q2_rad"], raw["tau2_nm"]  # in the unit that a name states, else as in the file
    fixed = {"": 1.0}
    ranked = []
    for (unit, scale), sign in product((fixed if knee.unit else ANGLE_UNITS).items(), (1, -1)):
        if pose is not None:
            share, beta, made = _equation(pose, sign * scale * angle, push, raw.rate_hz, gravity)
        else:
            hip = Pose(scale * raw["q1_rad"], np.gradient(_known(scale * raw["q1_rad"]), 1.0 / raw.rate_hz))
            share, beta, made = _equation(hip, sign * scale * angle, push, raw.rate_hz, gravity)
        ranked.append((share, unit, sign, 1 if beta[0] > 0 else -1, made))
    ranked.sort(key=lambda row: row[0])
    share, unit, sign, works, made = ranked[0]
    warnings = []
    if ranked[1][0] < CLEAR * share:
        warnings.append(f"the knee's unit and sign are a close call: {100 * share:.0f} % of the torque left against "
                        f"{100 * ranked[1][0]:.0f} %; look at the plot")
    shown = knee.unit or unit
    out = {"q2_rad": msgspec.structs.replace(knee, unit=shown, sign=1 if sign > 0 else -1),
           "tau2_nm": msgspec.structs.replace(torque, sign=1 if works > 0 else -1)}
    if "tau2_cmd_nm" in columns:
        out["tau2_cmd_nm"] = msgspec.structs.replace(columns["tau2_cmd_nm"], sign=1 if works > 0 else -1)
    if pose is None and "q1_rad" in columns:
        out["q1_rad"] = msgspec.structs.replace(columns["q1_rad"], unit=columns["q1_rad"].unit or unit)
    notes = {"q2_rad": f"in {shown or 'rad'}, sign {sign:+d}, the equation of motion leaves {100 * share:.1f} % of the "
                       f"torque (next best: {100 * ranked[1][0]:.0f} %)",
             "tau2_nm": f"with sign {works:+d} inertias are positive, and it does the knee's work"}
    if torque.unit.lower() in ("a", "ma") or not torque.unit:
        warnings.append(f"the scale of tau2_nm cannot be seen: set scale to N m per "
                        f"{torque.unit or 'unit'} of {torque.name!r} if it is not in N m at the joint")
    return Found(out, notes, warnings, (works * lowpass(_known(push), min(FAST_HZ, 0.2 * raw.rate_hz), raw.rate_hz),
                                        works * made))


def _known(x: FloatArray) -> FloatArray:
    return np.where(np.isfinite(x), x, np.nanmean(x))


def _equation(hip: Pose, q2: FloatArray, torque: FloatArray, rate_hz: float, gravity: float
              ) -> tuple[float, FloatArray, FloatArray]:
    """What tau = Z beta with least squares leaves of the torque, as a share; beta (9,); the torque that it makes (n,).

    A beta without positive inertias is no leg's: its residual counts as the whole torque.
    """
    mechanism = leg2(gravity_mps2=gravity, velocity_scale=0.05)
    cutoff = min(FAST_HZ, 0.2 * rate_hz)
    q = lowpass(np.stack([hip.q1, _known(q2)], axis=-1), cutoff, rate_hz)
    rate = lowpass(np.stack([hip.rate, np.gradient(_known(q2), 1.0 / rate_hz)], axis=-1), cutoff, rate_hz)
    z = mechanism.regressor(q, rate, np.gradient(rate, 1.0 / rate_hz, axis=0))
    trim = slice(int(rate_hz), -int(rate_hz)) if len(q) > 6 * rate_hz else slice(None)
    tau = lowpass(_known(torque), cutoff, rate_hz)
    rows = np.concatenate([z[trim, 0], z[trim, 1]])
    wanted = np.concatenate([np.zeros(len(z[trim])), tau[trim]])
    beta = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    left = float(np.sqrt(np.sum((rows @ beta - wanted) ** 2) / max(float(np.sum(wanted**2)), 1e-30)))
    sane = beta[0] * beta[1] > 0 and beta[2] ** 2 < beta[0] * beta[1]
    return left if sane else max(left, 1.0), beta, np.asarray(z[:, 1] @ beta)

