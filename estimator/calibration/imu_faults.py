"""IMU columns whose axis, sign or unit is wrong, and a lever arm that is: the IMU contradicts itself.

The gyro's integral and the accelerometer's tilt are one angle, and what gravity leaves of the accelerometer is the
lever arm's share of the motion (docs/theory.md). That holds under one reading of the three columns, and under its
mirror image.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from typing import NamedTuple

import numpy as np

from daq import Dataset, FloatArray
from estimator.calibration.units import DEGREE, TWICE, G, correction, tried
from estimator.calibration.windows import CLEAR, bounded, cut, typical, usual
from estimator.signals import IMU_COLUMNS, lowpass

WINDOW_S, FAST_HZ = 1.0, 8.0
"""Length of a window, in which the gyro's integral is the angle; above the frequency links ring."""
LEVER_M, LEVER_SHARE = 0.03, 0.25
"""A lever arm that differs by more than both, in metres and as a share of the larger, may be wrong."""
AROUND, AROUND_OTHER = 2.0, 1.3
"""The accelerometer's median length is gravity's within the first factor, or its unit is another: one that makes
gravity of it within the second, or else a scale of the sensor's own."""
MOST_SCALE, LEAST_SCALE, SCALE_STEP = 1.7, 0.03, 1e-4
"""Largest factor of a gyro that is searched for, smallest error that is named, and resolution of the search."""
UNIT_HZ = 1.0
"""Below it the tilt of the accelerometer is the angle of a link that swings, which shows the unit of a gyro."""
GYRO, ACCEL_X, ACCEL_Y = IMU_COLUMNS


@dataclass(frozen=True)
class ImuReading:
    """accel = axes @ accel_read, gyro = factor * gyro_read, and how far it is from what physics makes of it."""

    axes: FloatArray
    """(2, 2)"""
    factor: float
    left: float
    """Typical rms residual of a window [m/s2]."""
    lever_arm: float
    """That fits best [m]."""
    left_as_declared: float
    """The same with the lever arm that the rig declares [m/s2]."""
    gravity: float
    """Median of a window [m/s2]."""

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
        own = np.argmax(np.abs(self.axes), axis=1)
        scales = dict(zip(IMU_COLUMNS[1:], self.axes[[0, 1], own].tolist())) | {GYRO: self.factor}
        what, write = correction(scales, dict(zip(scales, [IMU_COLUMNS[1 + k] for k in own])))
        return f"{what}: {write}, or correct calibration.imu_mount"

    def told(self, as_read: ImuReading) -> str:
        """The remedy, and what it gains over the columns as they are."""
        before = as_read.left_as_declared
        gain = _fall(before, self.left) if CLEAR * self.left < before else "the link hangs down"
        return f"{self}; with it {gain}"


def read_imu(datasets: Sequence[Dataset], lever_arm: float, gravity: float, hangs: bool = True
             ) -> tuple[ImuReading, tuple[ImuReading, ...]]:
    """The IMU's columns as they are, and the readings that agree with themselves much better: those with the fewest
    changes, of which only the knee's equation can tell an image from its mirror. None where the columns are right.

    A link that `hangs` from a passive pivot feels gravity along -y most of the time; a driven one may stand.
    """
    unit = _accelerometer_unit(datasets, gravity)
    factors = [sign * f for f in (1.0, DEGREE, *_gyro_unit(datasets)) for sign in (1.0, -1.0)]
    ways = [(np.eye(2), 1.0), *((unit * axes, factor) for factor in dict.fromkeys(factors) for axes in _axes())]
    ways += [(np.diag(scales), 1.0) for scales in ((G, 1.0), (1.0, G))]  # one axis alone in g
    as_read, *found = imu_readings(datasets, ways, lever_arm, hangs)
    # the median length of a link that whirls is not gravity's
    as_it_weighs, *weigh = (abs(np.log(reading.gravity / gravity)) < np.log(AROUND_OTHER)
                            for reading in (as_read, *found))
    found = [reading for reading, weighs in zip(found, weigh) if reading.left < np.inf and (unit == 1.0 or weighs)]
    least = min((reading.left for reading in found), default=np.inf)
    if (unit == 1.0 or as_it_weighs) and unit * as_read.left < CLEAR * least:
        return as_read, ()
    near = [reading for reading in found if reading.left < CLEAR * least]
    fewest = min((reading.changes for reading in near), default=0)
    return as_read, tuple(sorted((r for r in near if r.changes <= fewest + 1), key=lambda r: (r.changes, r.left)))


def imu_readings(datasets: Sequence[Dataset], ways: Iterable[tuple[FloatArray, float]], lever_arm: float, hangs: bool
                 ) -> list[ImuReading]:
    """Readings of the IMU by each of `ways`: axes (2, 2), and the gyro's factor."""
    read = [_as_read(data, hangs) for data in datasets]
    turned = cache(partial(_turned, read))
    return [_judge(read, turned(factor), axes, factor, lever_arm, hangs) for axes, factor in ways]


def wrong_scale(datasets: Sequence[Dataset], lever_arm: float, gravity: float, hangs: bool = True) -> str:
    """A sentence where the accelerometer shows another size of the gyro's rate than it reads, else empty.

    Gravity turns in the link's frame by the rate's integral, so its direction shows the rate's scale.
    """
    def judged(log_factor: float) -> ImuReading:
        return imu_readings(datasets, [(np.eye(2), float(np.exp(log_factor)))], lever_arm, hangs)[0]

    from scipy.optimize import minimize_scalar  # 0.2 s to import

    edge = float(np.log(MOST_SCALE))
    best = judged(float(minimize_scalar(lambda x: judged(x).left, bounds=(-edge, edge), method="bounded",
                                        options={"xatol": SCALE_STEP}).x))
    as_read = judged(0.0)
    if abs(best.factor - 1.0) < LEAST_SCALE or not CLEAR * best.left < as_read.left:
        return ""
    return (f"the gyro reads about {1.0 / best.factor:.2f} times the rate by which the accelerometer turns (scale "
            f"error {1.0 / best.factor - 1.0:+.2f}): check its sensitivity in the data sheet, set name = \"{GYRO}\", "
            f"scale = {best.factor:.3g} under [columns.{GYRO}], and run legid diagnose, which measures the error; "
            f"with it {_fall(as_read.left, best.left)}")


def wrong_lever(reading: ImuReading, lever_arm: float) -> str:
    """A sentence where the IMU shows another lever arm than the rig's, else empty."""
    off = abs(reading.lever_arm - lever_arm)
    if off < LEVER_M or off < LEVER_SHARE * max(reading.lever_arm, lever_arm):
        return ""
    if reading.left_as_declared < CLEAR * reading.left:
        return ""
    return (f"the IMU looks {reading.lever_arm:.2g} m from the pivot, not {lever_arm:.2g}: measure lever_arm_m under "
            f"[imu], or correct calibration.imu_mount; with it {_fall(reading.left_as_declared, reading.left)}")


def _fall(before: float, after: float) -> str:
    return f"the accelerometer's residual falls from {before:.2g} to {after:.2g} m/s2"


def _accelerometer_unit(datasets: Sequence[Dataset], gravity: float) -> float:
    """Factor that makes gravity of the accelerometer's median length: 1, a unit's, or else whatever does (counts)."""
    length = float(np.nanmedian([np.nanmedian(np.hypot(d[ACCEL_X], d[ACCEL_Y])) for d in datasets]))
    if gravity <= 0.0 or not 0.0 < length < np.inf:
        return 1.0
    unit = min(tried(ACCEL_X).values(), key=lambda scale: abs(np.log(length * scale / gravity)))
    off = abs(np.log(length * unit / gravity))
    return unit if off < np.log(AROUND if unit == 1.0 else AROUND_OTHER) else gravity / length


def _gyro_unit(datasets: Sequence[Dataset]) -> tuple[float, ...]:
    """The unit that the gyro may be in by how fast the accelerometer's tilt turns, whatever its axes and signs."""
    turned, read = 0.0, 0.0
    for data in datasets:
        tilt = np.unwrap(np.arctan2(_known(data[ACCEL_X]), -_known(data[ACCEL_Y])))
        rate = np.gradient(lowpass(tilt, UNIT_HZ, data.rate_hz)) * data.rate_hz
        turned += float(np.sum(rate**2))
        read += float(np.sum(lowpass(_known(data[GYRO]), UNIT_HZ, data.rate_hz) ** 2))
    if not (0.0 < turned < np.inf and 0.0 < read < np.inf):
        return ()
    return (min((*tried(GYRO).values(), TWICE), key=lambda factor: abs(np.log(factor**2 * read / turned))),)


def _axes() -> Iterator[FloatArray]:
    for order in (np.eye(2), np.eye(2)[::-1]):
        for x, y in product((1.0, -1.0), repeat=2):
            yield np.diag([x, y]) @ order


class _Read(NamedTuple):
    """What filters make of a run's columns, whatever their signs, units and axes."""

    rate_hz: float
    accel: FloatArray
    """(n, 2)"""
    gyro: FloatArray
    """(n,)"""

    def windows(self, x: FloatArray) -> FloatArray:
        """(W, L, ...) of x (n, ...) without what only rings."""
        fast = lowpass(x, min(FAST_HZ, 0.2 * self.rate_hz), self.rate_hz)
        return cut(fast, min(max(int(WINDOW_S * self.rate_hz), 8), len(x)))


def _as_read(data: Dataset, hangs: bool) -> _Read:
    """A link that `hangs` ends where it began: what its gyro shows beyond that is a bias."""
    gyro = _known(data[GYRO])
    return _Read(data.rate_hz, np.stack([_known(data[ACCEL_X]), _known(data[ACCEL_Y])], axis=1),
                 gyro - hangs * gyro.mean())


class _Turned(NamedTuple):
    """What a link's motion by its gyro does to an accelerometer's x, then y, in each window of a run."""

    swing: FloatArray
    """(W, 2 L) by the motion at a distance of 1 m from the pivot."""
    plane: FloatArray
    """(W, 2 L, 2) by gravity along and across the link at the start of the window."""
    power: FloatArray
    """(W,) mean square of the rate."""

    def less_gravity(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(W, 2 L) what no gravity at the start of each window explains of x (W, 2 L), and (W, 2) the one that does."""
        across = self.plane.swapaxes(1, 2)
        gram = across @ self.plane + 1e-9 * np.eye(2)  # a gyro in a wrong unit turns too fast to leave a plane
        at = np.linalg.solve(gram, across @ x[:, :, None])
        return np.asarray((x[:, :, None] - self.plane @ at)[:, :, 0]), np.asarray(at[:, :, 0])


def _turned(read: list[_Read], factor: float) -> list[_Turned]:
    """Of each run, by its gyro times `factor`."""
    found = []
    for one in read:
        rate = factor * one.gyro
        angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) / one.rate_hz
        c, s = np.cos(angle), np.sin(angle)
        parts = one.windows(np.stack([np.gradient(rate, 1.0 / one.rate_hz), -rate**2, s, -c, c, s, rate], axis=1))
        columns = [np.concatenate([parts[:, :, k], parts[:, :, k + 1]], axis=1) for k in (0, 2, 4)]
        found.append(_Turned(columns[0], np.stack(columns[1:], axis=2), np.mean(parts[:, :, 6] ** 2, axis=1)))
    return found


def _judge(read: Sequence[_Read], turned: Sequence[_Turned], axes: FloatArray, factor: float, lever_arm: float,
           hangs: bool) -> ImuReading:
    """One lever arm for all windows, and their typical residual."""
    squares, planes = [], []
    for one, way in zip(read, turned):
        felt = one.windows(one.accel @ axes.T)
        (swing, by_swing), (rest, by_rest) = (
            way.less_gravity(x) for x in (way.swing, felt.swapaxes(1, 2).reshape(len(felt), -1)))
        planes.append(np.stack([by_rest, by_swing]))
        squares.append(np.stack([np.mean(a * b, axis=1) for a, b in ((swing, swing), (swing, rest), (rest, rest))]))
    size, common, whole = np.concatenate(squares, axis=1)

    def left(arm: float) -> FloatArray:
        return np.maximum(whole - 2.0 * arm * common + arm**2 * size, 0.0)

    def arm_by(weights: FloatArray) -> float:
        return max(float(weights @ common / max(float(weights @ size), 1e-300)), 0.0)

    lever = arm_by(bounded(lambda weights: left(arm_by(weights)), size / usual(size)))
    power = np.concatenate([way.power for way in turned])
    best, declared = (typical(np.sqrt(left(arm)), power) for arm in (lever, lever_arm))
    stands = hangs and np.median([np.median(one.accel @ axes[1]) for one in read]) >= 0.0
    if stands or not np.isfinite(best):
        best = np.inf
    by_rest, by_swing = np.concatenate(planes, axis=1)
    gravity = float(np.median(np.hypot(*(by_rest - lever * by_swing).T)))
    return ImuReading(axes, factor, best, lever, declared, gravity)


def _known(x: FloatArray) -> FloatArray:
    return np.where(np.isfinite(x), x, np.nanmean(x))


