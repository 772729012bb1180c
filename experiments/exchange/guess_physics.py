"""Units and signs of a leg's signals by what they must add up to; `guess` says how."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Literal, NamedTuple, TypeVar

import numpy as np
from msgspec import structs
from scipy.ndimage import binary_dilation

from daq import BoolArray, Column, Dataset, FloatArray
from estimator.calibration import TRIED
from estimator.model import leg2
from estimator.signals import lowpass
from experiments.exchange.guess_names import says
from experiments.exchange.units import factor, unit_in_name

SLOW_HZ = 0.3
"""Below this the accelerometer gives the pivot's angle, above it the gyro's integral."""
FAST_HZ = 8.0
SMOOTHING_RADPS = 0.05
"""Velocity over which the sign of friction is smoothed."""
Sign = Literal[1, -1]
SIGNS: tuple[Sign, ...] = (1, -1)
CLEAR = 1.5
"""A guess whose runner-up leaves less than so many times its residual is called unsure."""
NOT_SURE = "NOT SURE: "
EXPLAINS = 0.5
"""What leaves a larger share is no explanation. Right units and signs leave 11 to 35 % of the torque of a moving leg
(up to two thirds of one that hardly moves), an absolute angle for a relative one about 56 %, a motor's angle 81 %."""


BRIDGED_S = 0.05
"""A longer gap is no straight line."""
RING_S = 0.3
"""Distance from such a gap within which it affects filters."""


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
    unexplained: list[str]
    """What no unit and sign makes fit: whatever stands in `columns` for it is not to be used."""
    check: tuple[FloatArray, FloatArray]
    """(n,) measured, and as physics makes it of the others."""
    pose: Pose | None = None
    left: float = 0.0
    """The share of the torque that the knee's best unit and sign leaves."""


@dataclass(frozen=True)
class Way:
    """One way to read columns, and what it leaves."""

    left: float
    """Residual as a share of what is to be explained."""
    unit: str
    """Of the angle or the rate; empty for the contract's own."""


W = TypeVar("W", bound=Way)


@dataclass(frozen=True)
class _Signed(Way):
    sign: Sign
    made: FloatArray
    """(n,) what is to be explained, as physics makes it."""

    def __str__(self) -> str:
        return f"{self.unit or 'rad'}, sign {self.sign:+d}"


@dataclass(frozen=True)
class _Turning(_Signed):
    """The gyro read against one axis of the accelerometer."""

    side: str
    """The axis across the link."""
    read: FloatArray
    lever: float
    pose: Pose


def find_imu(rate_hz: float, gyro: Mapping[str, FloatArray], accel: Mapping[str, FloatArray], gravity: float) -> Found:
    """Axes, units and signs of gyro and accelerometer, each axis (n,) as the file has it."""
    gyro, accel = ({name: filled(values) for name, values in axes.items()} for axes in (gyro, accel))
    turning = max(gyro, key=lambda name: float(np.std(gyro[name])))
    along = max(accel, key=lambda name: abs(float(np.median(accel[name]))))
    length = float(np.median(np.sqrt(sum(values**2 for values in accel.values()))))
    accel_unit, to_mps2 = min(TRIED["mps2"].items(), key=lambda one: abs(np.log(max(length, 1e-12) * one[1] / gravity)))
    out_sign = -int(np.sign(np.median(accel[along])))
    warnings, unexplained = [], []
    heavy = abs(length * to_mps2 / gravity - 1.0) <= 0.2
    if not heavy:
        unexplained.append(f"the accelerometer's median length is {length:.4g}, not gravity in m/s2, g, mg or mm/s2: "
                           "it may be in counts, or have gravity taken off")
    said = unit_in_name(along, "accel_y_mps2")
    if heavy and said and not _same(said, accel_unit, "accel_y_mps2"):
        warnings.append(f"the name of {along!r} says {said}, but its gravity is that of {accel_unit or 'm/s2'}")
    a_y = out_sign * to_mps2 * accel[along]
    best = []
    for side, (unit, scale), sign in product([name for name in accel if name != along], TRIED["radps"].items(), SIGNS):
        a_x = to_mps2 * accel[side]
        made, lever, pose = _tangential(a_x, a_y, sign * scale * gyro[turning], rate_hz, gravity)
        read = _band(a_x, rate_hz)
        # the axis across the plane of motion is explained by nothing, and by nothing well: only a live axis counts
        live = float(np.std(accel[side])) / max(float(np.std(np.stack(list(accel.values())), axis=1).max()), 1e-30)
        left = share_left(read, made) / max(live, 1e-6)
        best.append(_Turning(left, unit or "rad/s", sign, made, side, read, lever, pose))
    first, second, *_ = ranked(best)
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
        "accel_x_mps2": (f"across the link, in the plane of motion; the IMU's lever arm would be {first.lever:.3f} m"
                         if known else "NOT KNOWN: it does not fit the gyro"),
        "accel_y_mps2": (f"the axis that carries gravity, {length:.4g} {accel_unit or 'm/s2'} in the median"
                         if heavy else f"NOT KNOWN: no gravity in it, {length:.4g} in the median")}
    return Found(columns, notes, warnings, unexplained, (first.read, first.made), first.pose)


def ranked(ways: Iterable[W], stated: str | None = None) -> list[W]:
    """`ways`, what leaves least first; in front of it those in a unit that is stated, unless another unit explains, and
    far better."""
    out = sorted(ways, key=lambda way: way.left)
    named = [way for way in out if way.unit == stated]
    if not named or out[0].unit == stated or (
            out[0].left <= EXPLAINS and CLEAR * out[0].left < named[0].left):
        return out
    return named + [way for way in out if way.unit != stated]


def close_call(whose: str, what: str, first: Way, second: Way) -> list[str]:
    """A warning where the runner-up leaves little more than the first of `what`; else none."""
    if second.left >= CLEAR * first.left:
        return []
    return [f"{whose} are a close call: {first}, leaves {100 * first.left:.0f} % of {what}, {second}, "
            f"{100 * second.left:.0f} %; look at the plot"]


def share_left(wanted: FloatArray, made: FloatArray) -> float:
    """Share of `wanted` that `made` leaves, by their rms."""
    return float(np.sqrt(np.sum((made - wanted) ** 2) / max(float(np.sum(wanted**2)), 1e-30)))


def _same(one: str, other: str, column: str) -> bool:
    """Two names of one unit."""
    return bool(np.isclose(factor(one, column, ""), factor(other, column, "")))


def filled(x: FloatArray) -> FloatArray:
    """(n,) with straight lines over what is missing."""
    known = np.isfinite(x)
    return x if known.all() else np.interp(np.arange(x.size), np.flatnonzero(known), x[known])


def scale_warnings(name: str, torque: Column) -> list[str]:
    """The warning that the scale of a torque in amperes, or without a unit, does not show; none for another unit."""
    if torque.unit and torque.unit.lower() not in ("a", "ma"):
        return []
    return [f"the scale of {name} does not show: set scale to N m per {torque.unit or 'unit'} of {torque.name!r}"
            + ("" if torque.unit else " if it is not in N m at the joint")]


def smooth(x: FloatArray, rate_hz: float) -> FloatArray:
    """(n, ...) without gaps and without what is faster than a record's motion."""
    return lowpass(filled(x), min(FAST_HZ, 0.2 * rate_hz), rate_hz)


def inside(run: Dataset, names: list[str]) -> BoolArray:
    """(n,) True away from gaps of `names` that are no straight lines, without a second at each end of a long record."""
    def reached(where: BoolArray, seconds: float) -> BoolArray:
        return binary_dilation(where, np.ones(2 * round(seconds * run.rate_hz) + 1, bool))

    use = ~reached(~reached(~run.gap(names), 0.5 * BRIDGED_S), 0.5 * BRIDGED_S + RING_S)
    edge = int(run.rate_hz) if len(run) > 6 * run.rate_hz else 0
    use[:edge] = use[len(use) - edge :] = False
    return use


def _band(x: FloatArray, rate_hz: float) -> FloatArray:
    """(n,) without what drifts and what only rings."""
    return smooth(x, rate_hz) - lowpass(x, SLOW_HZ, rate_hz)


def _tangential(a_x: FloatArray, a_y: FloatArray, omega: FloatArray, rate_hz: float, gravity: float
                ) -> tuple[FloatArray, float, Pose]:
    """accel_x (n,) as gyro and gravity make it, band-passed; the lever arm that fits it, not negative; the motion."""
    turned = np.cumsum(omega - omega.mean()) / rate_hz
    tilt = np.unwrap(np.arctan2(a_x, -a_y))
    q1 = turned - lowpass(turned, SLOW_HZ, rate_hz) + lowpass(tilt, SLOW_HZ, rate_hz)
    swing, sine = (_band(x, rate_hz) for x in (np.gradient(omega, 1.0 / rate_hz), gravity * np.sin(q1)))
    lever = max(float(swing @ (_band(a_x, rate_hz) - sine) / max(float(swing @ swing), 1e-30)), 0.0)
    return lever * swing + sine, lever, Pose(q1, omega)


@dataclass(frozen=True)
class _Knee(_Signed):
    """Angles in one unit and sign, and what the equation of motion leaves of the torque."""

    hip_unit: str
    works: Sign


def find_knee(raw: Dataset, columns: Mapping[str, Column], pose: Pose | None, gravity: float) -> Found:
    """Unit and sign of the knee's angle, sign of its torque; with an encoder on the pivot, its unit too.

    `raw` has the columns as the file has them but for units that names state. A name's unit is kept unless another one
    explains the torque, and far better. Without a torque in `columns` the one of `raw` is the error of the command
    `q2_cmd_rad`: it has the sign of the knee's angle, and a scale that is not known.
    """
    knee, torque = columns["q2_rad"], columns.get("tau2_nm")
    what = f"the torque {torque.name!r}" if torque else f"the error of the command {columns['q2_cmd_rad'].name!r}"
    short = "the torque" if torque else "the command's error"
    push = filled(raw["tau2_nm"])
    ways = _knees(raw, columns, pose, push, gravity)
    first, second, *_ = ranked(ways, knee.unit or None)
    unit = first.unit or "rad"
    warnings, unexplained = overruled(knee, ways, first.unit, short), []
    known, close = first.left <= EXPLAINS, close_call("the knee's unit and sign", short, first, second)
    if not known:
        unexplained.append(
            f"no unit and sign of {knee.name!r} explains {what} (the best leaves "
            f"{100 * first.left:.0f} %): too little motion, the motor's angle (scale = 1 / gear ratio), an absolute "
            "angle, another joint's, or late" + ("" if pose is None else ", or the IMU turned against the link"))
    else:
        warnings += close
    out = {"q2_rad": structs.replace(knee, unit=first.unit, sign=first.sign)}
    out |= {name: structs.replace(columns[name], sign=first.works) for name in ("tau2_nm", "tau2_cmd_nm")
            if name in columns}
    if torque is None:
        command = columns["q2_cmd_rad"]
        out["q2_cmd_rad"] = structs.replace(
            command, unit=command.unit or first.unit, sign=command.sign if first.sign > 0 else -command.sign)
        warnings += unexplained  # a loop's delay or integral is in the error, too
        unexplained, known = [], True
    if pose is None and "q1_rad" in columns:
        out["q1_rad"] = structs.replace(columns["q1_rad"], unit=first.hip_unit)
    prefix = NOT_SURE * (bool(close) or first.left > EXPLAINS)
    notes = {"q2_rad": f"{prefix}in {unit}, sign {first.sign:+d}, the equation of motion explains all but "
                       f"{100 * first.left:.1f} % of {short} (next best: {100 * second.left:.0f} %)",
             "tau2_nm": f"{prefix}with sign {first.works:+d} inertias are positive, and the torque drives the knee"
             } if known else {"q2_rad": f"NOT KNOWN: no unit and sign explains {short}",
                              "tau2_nm": "NOT KNOWN: its sign does not show"}
    if torque is None:
        del notes["tau2_nm"]
    else:
        warnings += scale_warnings("tau2_nm", torque)
    if not knee.unit and says(knee.name, "motor"):
        warnings.append(f"{knee.name!r} sounds like the motor's angle: then set unit, scale (1 / gear ratio) by hand")
    read = first.works * smooth(push, raw.rate_hz)
    return Found(out, notes, warnings, unexplained, (read, first.works * first.made), left=first.left)


def _knees(raw: Dataset, columns: Mapping[str, Column], pose: Pose | None, push: FloatArray, gravity: float
           ) -> list[_Knee]:
    """What every unit and sign leaves. A pivot's encoder without a unit of its own has the knee's."""
    knee, hip = columns["q2_rad"], columns.get("q1_rad", Column(name=""))
    angles = {unit: scale * filled(raw["q2_rad"]) for unit, scale in units_of(knee).items()}
    if pose is not None:
        poses = {hip.unit: pose}
    else:
        q1 = filled(raw["q1_rad"])
        poses = {unit: Pose(scale * q1, scale * np.gradient(q1, 1.0 / raw.rate_hz))
                 for unit, scale in units_of(hip).items() if not hip.unit or unit == hip.unit}
    measured = [name for name in ("q1_rad", "q2_rad", "tau2_nm") if name in raw]
    follows = "tau2_nm" not in columns
    use = inside(raw, measured if pose is None else measured[-2:])
    out = []
    for (hip_unit, link), (unit, angle), sign in product(poses.items(), angles.items(), SIGNS):
        if pose is None and not (hip.unit or knee.unit) and unit != hip_unit:
            continue
        left, beta, made = _equation(link, sign * angle, push, use, raw.rate_hz, gravity)
        works: Sign = 1 if beta[0] > 0 else -1
        against = follows and works != sign  # a drive pushes the angle towards its command
        out.append(_Knee(max(left, 1.0) if against else left, unit, sign, made, hip_unit, works))
    return out


def units_of(column: Column) -> dict[str, float]:
    """Unit -> factor to be put on an angle that is read by the unit of its name, for every unit that it may have."""
    stated = factor(column.unit, "q2_rad", column.name)
    return {column.unit: 1.0} | {unit: scale / stated for unit, scale in TRIED["rad"].items()
                                 if not np.isclose(scale, stated)}


def overruled(column: Column, ways: Iterable[Way], unit: str, what: str) -> list[str]:
    """A warning where the name of an angle states another unit than `unit`, which explains `what` better; else none."""
    left = {way.unit: way.left for way in ranked(ways)[::-1]}
    return [] if not column.unit or unit == column.unit else [
        f"the name of {column.name!r} says {column.unit}, but in {unit or 'rad'} the equation of motion leaves "
        f"{100 * left[unit]:.0f} % of {what}, not {100 * left[column.unit]:.0f} %: {unit or 'rad'} is taken"]


def _equation(hip: Pose, q2: FloatArray, torque: FloatArray, use: BoolArray, rate_hz: float, gravity: float
              ) -> tuple[float, FloatArray, FloatArray]:
    """What tau = Z beta with least squares leaves of the torque, as a share; beta (9,); the torque that it makes (n,).

    Only samples of `use` (n,) do.

    A beta without positive inertias is no leg's: its residual counts as the whole torque.
    """
    mechanism = leg2(gravity_mps2=gravity, velocity_scale=SMOOTHING_RADPS)
    q = smooth(np.stack([hip.q1, q2], axis=-1), rate_hz)
    rate = smooth(np.stack([hip.rate, np.gradient(q2, 1.0 / rate_hz)], axis=-1), rate_hz)
    z = mechanism.regressor(q, rate, np.gradient(rate, 1.0 / rate_hz, axis=0))
    tau = smooth(torque, rate_hz)
    rows = np.concatenate([z[use, 0], z[use, 1]])
    wanted = np.concatenate([np.zeros(int(use.sum())), tau[use]])
    beta = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    left = share_left(wanted, rows @ beta)
    sane = beta[0] * beta[1] > 0 and beta[2] ** 2 < beta[0] * beta[1]
    return left if sane else max(left, 1.0), beta, z[:, 1] @ beta
