"""The joints' motion from encoders and IMUs together: which sensors show which joint, and filtered starting values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from daq import FloatArray
from estimator.errors import FitError
from estimator.model import ImuPlace, Mechanism
from estimator.signals.filters import central_difference, lowpass
from estimator.signals.imu import accelerometer_at, accelerometer_slopes, fuse_tilt, imu_columns, tilt

STARTS = 12
"""Angles all round at which the integral of a gyro is tried to begin."""
STEPS, CONVERGED_RAD = 20, 1e-5
"""Most steps of least squares, which end where no angle moves by more."""
MODEL_MPS2, BIAS_RADPS = 0.5, 0.02
"""By what filtered motion misses an accelerometer, and a usual gyro's bias: so much keeps that of a short segment near
zero."""
LEAST_MPS2 = 1e-6
"""What a record without noise leaves of an accelerometer is taken for no less."""


class Kinematics(NamedTuple):
    """Filtered angles and their differences, each (n, joints)."""

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray


class Sight(NamedTuple):
    """As many sensors as joints, which together determine all of them."""

    rows: FloatArray
    """(n, n): what each reads is its row times the joints' angles."""
    encoders: tuple[int, ...]
    """The joints of the first rows' encoders"""
    imus: tuple[int, ...]
    """The numbers of the other rows' IMUs"""


def sight(mechanism: Mechanism, encoders: Sequence[int], has_imu: bool) -> Sight:
    """The encoders, and of the IMUs, by rising link, those that show what these do not.

    Raises `FitError` naming the joints that nothing shows.
    """
    rows, imus = [np.eye(mechanism.n)[j] for j in encoders], list[int]()
    numbers = sorted(range(len(mechanism.imus)), key=lambda k: mechanism.imus[k].link) if has_imu else []
    for k in numbers:
        more = [*rows, mechanism.transform[mechanism.imus[k].link]]
        if _rank(tuple(map(tuple, more))) == len(more):
            rows, imus = more, [*imus, k]
    if len(rows) < mechanism.n:
        free = np.linalg.svd(np.array(rows).reshape(-1, mechanism.n))[2][len(rows):]
        hidden = [str(j + 1) for j in np.flatnonzero(np.abs(free).max(axis=0) > 1e-9)]
        raise FitError(f"no sensor tells the {'angle of joint' if len(hidden) == 1 else 'angles of joints'} "
                       f"{' and '.join(hidden)}{'' if len(hidden) == 1 else ' apart'}: with {len(encoders)} "
                       f"{'encoder' if len(encoders) == 1 else 'encoders'} and {len(numbers)} "
                       f"{'IMU' if len(numbers) == 1 else 'IMUs'} {mechanism.n - len(rows)} of {mechanism.n} angles "
                       "stay open; give an encoder, or an IMU on a link between them")
    return Sight(np.array(rows), tuple(encoders), tuple(imus))


@cache
def _rank(rows: tuple[tuple[float, ...], ...]) -> int:
    """Of the matrix of these rows; a fit asks the same some ten times."""
    return int(np.linalg.matrix_rank(np.array(rows)))


def with_imus(k: Kinematics, imu: Mapping[str, FloatArray], mechanism: Mechanism, rate_hz: float,
              cutoff_hz: float | None, order: int, fused: bool) -> Kinematics:
    """`k`, that encoders give, with the joints that have none (NaN there) from the IMU columns `imu`, eq. (63).

    `fused` takes the gyro's integral for the fast part of a link's angle instead of the accelerometer alone. Beyond
    link 1 the joint that carries an IMU is itself moved about, see `_ridden`; so are long chains taken.
    """
    found = sight(mechanism, [int(j) for j in np.flatnonzero(np.isfinite(k.q).all(axis=0))], True)
    if not found.imus:
        return k
    readings = [[imu[name] for name in imu_columns(i)] for i in found.imus]
    places = [mechanism.imus[i] for i in found.imus]
    known = np.stack([a[:, list(found.encoders)] for a in k])
    if mechanism.n > 2 or any(place.link > 0 for place in places):
        return _ridden(known, readings, places, found.rows, mechanism, rate_hz, cutoff_hz, order)
    shown = np.stack([_first_link(r, mechanism, p, rate_hz, cutoff_hz, order, fused) for r, p in zip(readings, places)])
    return Kinematics(*(np.concatenate([known, shown.transpose(1, 2, 0)], axis=-1) @ np.linalg.inv(found.rows).T))


def _first_link(readings: Sequence[FloatArray], mechanism: Mechanism, place: ImuPlace, rate_hz: float,
                cutoff_hz: float | None, order: int, fused: bool) -> FloatArray:
    """(3, N) angle, rate and acceleration of link 1 by an IMU on it."""
    gyro, ax, ay = readings
    s, c, acceleration = tilt(ax, ay, gyro, rate_hz, place.lever_arm, cutoff_hz, order)
    angle = np.unwrap(np.arctan2(s, c))
    if fused:
        angle = fuse_tilt(ax, ay, gyro, rate_hz, place.lever_arm, cutoff_hz)
    rate = central_difference(angle, 1.0 / rate_hz) if fused else gyro  # fused: free of the gyro's bias
    if mechanism.felt_gravity < 0.0:  # angles count from upright
        angle = angle - np.pi * np.sign(np.median(angle))
    return np.stack([angle, lowpass(rate, cutoff_hz, rate_hz, order), acceleration])


def integral(rates: FloatArray, rate_hz: float) -> FloatArray:
    """(N, k) of rates (N, k) from zero, by the cubic through four samples of each interval."""
    wide = np.concatenate([2.0 * rates[:1] - rates[1:2], rates, 2.0 * rates[-1:] - rates[-2:-1]])
    steps = (13.0 * (rates[1:] + rates[:-1]) - wide[:-3] - wide[3:]) / (24.0 * rate_hz)
    return np.concatenate([np.zeros((1, rates.shape[1])), np.cumsum(steps, axis=0)])


def _ridden(known: FloatArray, readings: Sequence[Sequence[FloatArray]], places: Sequence[ImuPlace], rows: FloatArray,
            mechanism: Mechanism, rate_hz: float, cutoff_hz: float | None, order: int) -> Kinematics:
    """The joints' motion from encoders `known` (3, N, e) and IMUs that ride on moving links.

    Gyros and encoders give rates, accelerations, and angles up to an initial angle and a bias for each IMU. Least
    squares on the accelerometers (`accelerometer_at`) gives these two. All joints are filtered and differenced alike,
    so that large accelerations of a long chain cancel. (Measured on seven links: inertias 3 % low; 51 % otherwise.)
    """
    gyro = np.stack([r[0] for r in readings], axis=1)
    felt = lowpass(np.stack([a for r in readings for a in r[1:]], axis=1), cutoff_hz, rate_hz, order).T
    count, imus = gyro.shape
    time = (np.arange(count) - 0.5 * (count - 1)) / rate_hz
    whole = lowpass(integral(gyro, rate_hz), cutoff_hz, rate_hz, order)
    rate = central_difference(whole, 1.0 / rate_hz)
    acceleration = central_difference(rate, 1.0 / rate_hz)
    back = np.linalg.inv(rows)

    def motion(x: FloatArray) -> Kinematics:
        begin, bias = x[:imus], x[imus:]
        shown = (whole + begin + np.outer(time, bias), rate + bias, acceleration)
        return Kinematics(*(np.concatenate([k, s], axis=1) @ back.T for k, s in zip(known, shown)))

    def left(x: FloatArray, which: Sequence[int]) -> FloatArray:
        q = [a.T for a in motion(x)]
        return np.concatenate([accelerometer_at(mechanism, places[i], *q) for i in which]) \
            - felt[[2 * i + axis for i in which for axis in range(2)]]

    x = np.zeros(2 * imus)
    for i in range(imus):
        tried = [np.where(np.arange(x.size) == i, begin, x) for begin in np.arange(STARTS) * 2.0 * np.pi / STARTS]
        x = min(tried, key=lambda at: float(np.sum(left(at, [i]) ** 2)))
    damp = np.concatenate([np.zeros(imus), np.full(imus, (MODEL_MPS2 / BIAS_RADPS) ** 2)])
    for _ in range(STEPS):
        q = [a.T for a in motion(x)]
        by_angle, by_rate = (np.concatenate(s) for s in
                             list(zip(*(accelerometer_slopes(mechanism, place, *q) for place in places)))[1:3])
        turned = np.einsum("rjN,ji->riN", by_angle, back[:, known.shape[2] :])
        raised = np.einsum("rjN,ji->riN", by_rate, back[:, known.shape[2] :])
        slopes = np.concatenate([turned, turned * time + raised], axis=1)
        r = left(x, range(imus))
        usual = np.maximum(np.median(np.abs(r), axis=1), LEAST_MPS2)[:, None]
        weighted = slopes / (1.0 + (r / usual) ** 2)[:, None]
        step = np.linalg.solve(np.einsum("raN,rbN->ab", weighted, slopes) + np.diag(damp),
                               np.einsum("raN,rN->a", weighted, r) + damp * x)
        x = x - step
        if np.max(np.abs(step)) < CONVERGED_RAD:
            break
    x[:imus] = (x[:imus] + np.pi) % (2.0 * np.pi) - np.pi
    return motion(x)
