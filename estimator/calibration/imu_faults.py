"""IMU columns whose axis, sign or unit is wrong, and a lever arm that is: the IMU contradicts itself.

The gyro's integral and the accelerometer's tilt are one angle, and what gravity leaves of the accelerometer is the
lever arm's share of the motion (docs/theory.md). That holds under one reading of the three columns, and under its
mirror image.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from daq import Dataset, FloatArray
from estimator.signals import IMU_COLUMNS, lowpass

SLOW_HZ, FAST_HZ = 0.3, 8.0
"""Below the first the accelerometer gives the angle, above it the gyro; beyond the second links ring."""
CLEAR = 1.5
"""A reading must leave so many times less than the columns as they are."""
LEVER_M, LEVER_SHARE = 0.03, 0.25
"""A lever arm that differs by more than both, in metres and as a share of the larger, is wrong, ..."""
LEVER_CLEAR = 1.3
"""... if the other's residual is smaller by this factor."""
DEGREE, TURN = float(np.pi / 180.0), float(2.0 * np.pi)
G = 9.80665
GYRO_UNITS = {DEGREE: ("in degrees a second", 'unit = "deg/s"'), 1e-3 * DEGREE: ("in mdps", 'unit = "mdps"'),
              TURN / 60.0: ("in rpm", 'unit = "rpm"'), TURN: ("in turns a second", 'unit = "turn/s"'),
              1e-3: ("in mrad/s", "scale = 0.001"),
              1.0 / DEGREE: ("converted from degrees twice", f"scale = {1.0 / DEGREE:.6g}")}
"""Factor of a gyro's column -> its fault, and the entry of rig.toml that corrects it."""
ACCEL_UNITS = {G: ("in g", 'unit = "g"'), 1e-3 * G: ("in mg", 'unit = "mg"'), 1e-3: ("in mm/s2", "scale = 0.001")}
AROUND, AROUND_OTHER = 2.0, 1.3
"""The accelerometer's median length is gravity's within the first factor, or its unit is another: one that makes
gravity of it within the second, or else a scale of the sensor's own."""
GYRO, ACCEL_X, ACCEL_Y = IMU_COLUMNS


@dataclass(frozen=True)
class ImuReading:
    """accel = axes @ accel_read, gyro = factor * gyro_read, and how far it is from what physics makes of it."""

    axes: FloatArray
    """(2, 2)"""
    factor: float
    left: float
    """rms residual in the band [m/s2]."""
    lever_arm: float
    """That fits best [m]."""
    left_as_declared: float
    """The same with the lever arm that the rig declares [m/s2]."""

    @property
    def changes(self) -> int:
        """Number of columns that are read in another way."""
        return int(self.factor != 1.0) + int(np.sum(np.any(self.axes != np.eye(2), axis=1)))

    def applied(self, data: Dataset) -> Dataset:
        """`data` read this way."""
        x, y = self.axes @ np.stack([data[ACCEL_X], data[ACCEL_Y]])
        return replace(data, columns={**data.columns, GYRO: self.factor * data[GYRO], ACCEL_X: x, ACCEL_Y: y})

    def __str__(self) -> str:
        """What looks wrong, and its remedy."""
        looks, writes = [], []
        for name, row, own in ((ACCEL_X, self.axes[0], 0), (ACCEL_Y, self.axes[1], 1)):
            source = int(np.argmax(np.abs(row)))
            minus = "minus " if row[source] < 0 else ""
            entries = [f'name = "{(ACCEL_X, ACCEL_Y)[source]}"']
            if row[source] < 0:
                entries.append("sign = -1")
            scale = abs(float(row[source]))
            if source != own:
                looks.append(f"{name} looks like {minus}{(ACCEL_X, ACCEL_Y)[source]}")
            elif row[source] < 0:
                looks.append(f"{name} looks negated")
            if scale != 1.0:
                unit, entry = ACCEL_UNITS.get(scale) or _times(scale)
                looks.append(f"{name} looks {unit}")
                entries.append(entry)
            if len(entries) > 1 or source != own:
                writes.append(f"{', '.join(entries)} under [columns.{name}]")
        if self.factor != 1.0:
            unit, entry = GYRO_UNITS.get(abs(self.factor), ("", ""))
            looks.append(f"{GYRO} looks {' and '.join(filter(None, ['negated' * (self.factor < 0), unit]))}")
            entries = [f'name = "{GYRO}"', *["sign = -1"] * (self.factor < 0), *[entry] * bool(entry)]
            writes.append(f"{', '.join(entries)} under [columns.{GYRO}]")
        return f"{' and '.join(looks)}: set {' and '.join(writes)}, or correct calibration.imu_mount"


def read_imu(datasets: Sequence[Dataset], lever_arm: float, gravity: float, hangs: bool = True
             ) -> tuple[ImuReading, tuple[ImuReading, ...]]:
    """The IMU's columns as they are, and the readings that agree with themselves much better: those with the fewest
    changes, of which only the knee's equation can tell an image from its mirror. None where the columns are right.

    A link that `hangs` from a passive pivot feels gravity along -y most of the time; a driven one may stand.
    """
    unit = _accelerometer_unit(datasets, gravity)
    read = [_as_read(data) for data in datasets]
    as_read = _judge(read, np.eye(2), 1.0, lever_arm, gravity, hangs)
    factors = [sign * f for f in (1.0, DEGREE, *_gyro_unit(datasets)) for sign in (1.0, -1.0)]
    ways = [(unit * axes, factor) for axes, factor in product(_axes(), dict.fromkeys(factors))]
    ways += [(np.diag(scales), 1.0) for scales in ((G, 1.0), (1.0, G))]  # one axis alone in g
    found = [_judge(read, axes, factor, lever_arm, gravity, hangs) for axes, factor in ways
             if not hangs or _gravity_down(read, axes) > 0.0]
    found = [reading for reading in found if reading.left < np.inf]
    least = min((reading.left for reading in found), default=np.inf)
    if unit == 1.0 and as_read.left < CLEAR * least:
        return as_read, ()
    near = [reading for reading in found if reading.left < CLEAR * least]
    fewest = min((reading.changes for reading in near), default=0)
    return as_read, tuple(sorted((r for r in near if r.changes <= fewest + 1), key=lambda r: (r.changes, r.left)))


def wrong_lever(reading: ImuReading, lever_arm: float) -> str:
    """A sentence where the IMU shows another lever arm than the rig's, else empty."""
    off = abs(reading.lever_arm - lever_arm)
    if off < LEVER_M or off < LEVER_SHARE * max(reading.lever_arm, lever_arm):
        return ""
    if reading.left_as_declared < LEVER_CLEAR * reading.left:
        return ""
    return (f"the IMU looks {reading.lever_arm:.2g} m from the pivot, not {lever_arm:.2g}: measure lever_arm_m under "
            "[imu], or correct calibration.imu_mount")


def _accelerometer_unit(datasets: Sequence[Dataset], gravity: float) -> float:
    """Factor that makes gravity of the accelerometer's median length: 1, a unit's, or else whatever does (counts)."""
    length = float(np.nanmedian([np.nanmedian(np.hypot(d[ACCEL_X], d[ACCEL_Y])) for d in datasets]))
    if gravity <= 0.0 or not 0.0 < length < np.inf:
        return 1.0
    unit = min((1.0, *ACCEL_UNITS), key=lambda scale: abs(np.log(length * scale / gravity)))
    off = abs(np.log(length * unit / gravity))
    return unit if off < np.log(AROUND if unit == 1.0 else AROUND_OTHER) else gravity / length


def _gyro_unit(datasets: Sequence[Dataset]) -> tuple[float, ...]:
    """The unit that the gyro may be in by how fast the accelerometer's tilt turns, whatever its axes and signs."""
    turned, read = 0.0, 0.0
    for data in datasets:
        tilt = np.unwrap(np.arctan2(_known(data[ACCEL_X]), -_known(data[ACCEL_Y])))
        rate = np.gradient(lowpass(tilt, 3.0 * SLOW_HZ, data.rate_hz)) * data.rate_hz
        turned += float(np.sum(rate**2))
        read += float(np.sum(lowpass(_known(data[GYRO]), 3.0 * SLOW_HZ, data.rate_hz) ** 2))
    if not (0.0 < turned < np.inf and 0.0 < read < np.inf):
        return ()
    return (min((1.0, *GYRO_UNITS), key=lambda factor: abs(np.log(factor**2 * read / turned))),)


def _times(scale: float) -> tuple[str, str]:
    size = f"{1.0 / scale:.3g} times too large" if scale < 1.0 else f"{scale:.3g} times too small"
    return size, f"scale = {scale:.4g}"


def _axes() -> Iterator[FloatArray]:
    for order in (np.eye(2), np.eye(2)[::-1]):
        for x, y in product((1.0, -1.0), repeat=2):
            yield np.diag([x, y]) @ order


class _Read(NamedTuple):
    """What filters make of a run's columns, whatever their signs, units and axes."""

    rate_hz: float
    accel: FloatArray
    """(2, n)"""
    turned: FloatArray
    """(n,) angle by the gyro without what is slow"""
    swing: FloatArray
    """(2, n) band of the gyro's derivative and of minus its square"""


def _as_read(data: Dataset) -> _Read:
    omega = _known(data[GYRO])
    turned = np.cumsum(omega - omega.mean()) / data.rate_hz
    swing = np.stack([np.gradient(omega, 1.0 / data.rate_hz), -omega**2])
    return _Read(data.rate_hz, np.stack([_known(data[ACCEL_X]), _known(data[ACCEL_Y])]),
                 turned - lowpass(turned, SLOW_HZ, data.rate_hz), _band(swing, data.rate_hz).reshape(-1, 2).T)


def _judge(read: Sequence[_Read], axes: FloatArray, factor: float, lever_arm: float, gravity: float,
           hangs: bool) -> ImuReading:
    swings, rests = [], []
    for one in read:
        x, y = axes @ one.accel
        tilt = np.unwrap(np.arctan2(x, -y))
        q1 = factor * one.turned + lowpass(tilt, SLOW_HZ, one.rate_hz)
        rest = np.stack([x - gravity * np.sin(q1), y + gravity * np.cos(q1)])
        swings.append((one.swing * [[factor], [factor**2]]).T.ravel())
        rests.append(_band(rest, one.rate_hz))
    swing, rest = np.concatenate(swings), np.concatenate(rests)
    whole = float(np.sqrt(np.mean(rest**2)))
    lever = max(float(swing @ rest / max(float(swing @ swing), 1e-300)), 0.0)
    left, declared = (float(np.sqrt(np.mean((rest - arm * swing) ** 2))) for arm in (lever, lever_arm))
    if (hangs and _gravity_down(read, axes) <= 0.0) or not np.isfinite(whole):
        left = np.inf
    return ImuReading(axes, factor, left, lever, declared)


def _gravity_down(read: Sequence[_Read], axes: FloatArray) -> float:
    """Median of the axis along the link, towards the pivot [m/s2]: above zero for a link that hangs."""
    return float(np.median([-np.median(axes[1] @ one.accel) for one in read]))


def _known(x: FloatArray) -> FloatArray:
    return np.where(np.isfinite(x), x, np.nanmean(x))


def _band(x: FloatArray, rate_hz: float) -> FloatArray:
    """Both rows (2, n) without what drifts and what only rings, as one (2 n,)."""
    fast = lowpass(x.T, min(FAST_HZ, 0.2 * rate_hz), rate_hz)
    return np.asarray((fast - lowpass(x.T, SLOW_HZ, rate_hz)).ravel(), dtype=np.float64)
