"""Equations of IMUs on the links of a planar tree.

The IMU sits on link m, l_m along it; theta_k are absolute link angles from hanging, t_k = (cos, sin) theta_k is the
direction in which the end of link k moves as theta_k grows, e_k = (sin, -cos) theta_k that from its joint to its end.
The links k that carry link m have lengths l_k, so the IMU is at sum l_k e_k over these and m itself, and feels

    f = sum_k l_k (thetadd_k t_k - thetad_k^2 e_k) + g (0, 1)

Its x axis is t_m, its y axis e_m, and its gyro reads thetad_m. With d_k = theta_k - theta_m that is

    a_x = sum_k l_k ( thetadd_k cos d_k - thetad_k^2 sin d_k) + g sin theta_m
    a_y = sum_k l_k (-thetadd_k sin d_k - thetad_k^2 cos d_k) - g cos theta_m

where d_m = 0: on link 1 they are `accelerometer`'s. Where angles count from upright (the walker) both e_k and t_k turn
round, and with them the sign of g alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import FloatArray
from estimator.model import ImuPlace, Mechanism
from estimator.signals.channels import Channel, imu_channels
from estimator.signals.filters import central_difference, lowpass

IMU_COLUMNS = ("gyro_radps", "accel_x_mps2", "accel_y_mps2")
"""Of the first IMU."""
CROSSOVER_HZ = 0.3


def imu_columns(number: int) -> tuple[str, str, str]:
    """The contract's columns of an IMU, 0-based in the rig's order."""
    own = str(number + 1)
    return IMU_COLUMNS if number == 0 else (f"gyro{own}_radps", f"accel{own}_x_mps2", f"accel{own}_y_mps2")


def accelerometer(q1: FloatArray, q1d: FloatArray, q1dd: FloatArray, lever_arm: float,
                  gravity: float) -> tuple[FloatArray, FloatArray]:
    """(a_x, a_y) [m/s2]: a_x = l q1dd + g sin q1 (tangential), a_y = -l q1d^2 - g cos q1 (along the link).

    The true pair behind the paper's printed (63), which mixes two conventions.
    """
    return lever_arm * q1dd + gravity * np.sin(q1), -lever_arm * q1d**2 - gravity * np.cos(q1)


def total(values: FloatArray, joints: Sequence[int]) -> FloatArray:
    """(N,) sum of the rows `joints` of (n, N): absolute from joint angles, rates or accelerations."""
    return values[joints[0]] if len(joints) == 1 else values[list(joints)].sum(axis=0)


def carried(mechanism: Mechanism, place: ImuPlace, q: FloatArray, qd: FloatArray, qdd: FloatArray
            ) -> tuple[FloatArray, FloatArray]:
    """(a_x, a_y) [m/s2] of the link's joint, in the IMU's axes, at joint angles and their derivatives (n, N)."""
    out = np.zeros((2, q.shape[1]))
    here = total(q, mechanism.joints_to(place.link))
    for k in mechanism.joints_to(place.link)[:-1]:
        joints, length = mechanism.joints_to(k), mechanism.link_lengths[k]
        d, turn, spin = total(q, joints) - here, length * total(qdd, joints), length * total(qd, joints) ** 2
        c, s = np.cos(d), np.sin(d)
        out += turn * c - spin * s, -turn * s - spin * c
    return out[0], out[1]


def accelerometer_at(mechanism: Mechanism, place: ImuPlace, q: FloatArray, qd: FloatArray, qdd: FloatArray
                     ) -> tuple[FloatArray, FloatArray]:
    """(a_x, a_y) [m/s2] of an IMU at joint angles and their derivatives (n, N); see the module's text."""
    joints = mechanism.joints_to(place.link)
    x, y = accelerometer(total(q, joints), total(qd, joints), total(qdd, joints), place.lever_arm,
                         mechanism.felt_gravity)
    if len(joints) == 1:
        return x, y
    more_x, more_y = carried(mechanism, place, q, qd, qdd)
    return x + more_x, y + more_y


def accelerometer_slopes(mechanism: Mechanism, place: ImuPlace, q: FloatArray, qd: FloatArray, qdd: FloatArray,
                         *, turned: tuple[FloatArray, FloatArray] | None = None
                         ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """`accelerometer_at` (2, N), and its derivatives (2, n, N) by the joints' angles, rates and accelerations (n, N).

    `turned`, where they are known, are cosine and sine of the link's absolute angle, (N,) each.
    """
    n, count = q.shape
    joints = mechanism.joints_to(place.link)
    by_angle, by_rate, by_acceleration = np.zeros((3, 2, n, count))  # of absolute angles, then of the joints'
    here, g, own, lever = total(q, joints), mechanism.felt_gravity, place.link, place.lever_arm
    rate = total(qd, joints)
    cosine, sine = (np.cos(here), np.sin(here)) if turned is None else turned
    by_angle[0, own], by_angle[1, own] = g * cosine, g * sine
    by_rate[1, own] = -2.0 * lever * rate
    by_acceleration[0, own] = lever
    felt = by_angle[::-1, own].copy()
    felt[0] += lever * total(qdd, joints)
    felt[1] = 0.5 * rate * by_rate[1, own] - felt[1]
    if len(joints) == 1:
        return felt, by_angle, by_rate, by_acceleration
    felt += carried(mechanism, place, q, qd, qdd)
    for k in joints[:-1]:
        to, length = mechanism.joints_to(k), mechanism.link_lengths[k]
        d, rate = total(q, to) - here, total(qd, to)
        turn, spin, c, s = length * total(qdd, to), length * rate**2, np.cos(d), np.sin(d)
        slope = np.stack([-turn * s - spin * c, -turn * c + spin * s])
        by_angle[:, k] += slope
        by_angle[:, own] -= slope
        by_rate[:, k] = -2.0 * length * rate * np.stack([s, c])
        by_acceleration[:, k] = length * np.stack([c, -s])
    t = mechanism.transform
    by_angle, by_rate, by_acceleration = (np.ascontiguousarray(np.einsum("rkN,kj->rjN", a, t))
                                          for a in (by_angle, by_rate, by_acceleration))
    return felt, by_angle, by_rate, by_acceleration


def imu_readings(mechanism: Mechanism, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> dict[Channel, FloatArray]:
    """Readings of all IMUs, (N,) each, at joint angles and their derivatives (n, N)."""
    out: dict[Channel, FloatArray] = {}
    for k, place in enumerate(mechanism.imus):
        accel = accelerometer_at(mechanism, place, q, qd, qdd)
        out |= dict(zip(imu_channels(k), (total(qd, mechanism.joints_to(place.link)).copy(), *accel)))
    return out


def predicted_columns(mechanism: Mechanism, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> dict[str, FloatArray]:
    """Readings of `imu_readings`, by column, of arrays (N, n)."""
    readings = imu_readings(mechanism, q.T, qd.T, qdd.T)
    return {name: readings[channel] for k in range(len(mechanism.imus))
            for name, channel in zip(imu_columns(k), imu_channels(k))}


def tilt(accel_x: FloatArray, accel_y: FloatArray, gyro: FloatArray, rate_hz: float, lever_arm: float,
         cutoff_hz: float | None, order: int = 4) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(sin q1, cos q1, q1dd) from IMU samples (n,) by eq. (63) with corrected signs; inputs unfiltered.

    All three are low-passed alike; gravity is taken from the sensor's own mean norm, which cancels a
    common accelerometer gain.
    """
    x, y, rate = lowpass(np.stack([accel_x, accel_y, gyro], axis=1), cutoff_hz, rate_hz, order).T.copy()
    q1dd = central_difference(rate, 1.0 / rate_hz)
    s, c = x - lever_arm * q1dd, -y - lever_arm * rate**2
    norm = np.hypot(s, c)
    return s / norm, c / norm, q1dd


def fuse_tilt(accel_x: FloatArray, accel_y: FloatArray, gyro: FloatArray, rate_hz: float, lever_arm: float,
              cutoff_hz: float | None) -> FloatArray:
    """q1 (n,) [rad], unwrapped: the gyro's integral above CROSSOVER_HZ, gravity's tilt below it.

    Zero phase, so it may start a smoother; it is not an estimate with an error bar.
    """
    s, c, _ = tilt(accel_x, accel_y, gyro, rate_hz, lever_arm, cutoff_hz)
    angle = np.unwrap(np.arctan2(s, c))
    rate = 0.5 * (gyro[1:] + gyro[:-1]) / rate_hz
    integral = np.concatenate(([0.0], np.cumsum(rate)))
    slow = angle - integral
    if slow.shape[0] < 6 * rate_hz / CROSSOVER_HZ:
        trend = np.polynomial.Polynomial.fit(np.arange(slow.shape[0]), slow, 1)
        return integral + trend(np.arange(slow.shape[0]))
    return integral + lowpass(slow, CROSSOVER_HZ, rate_hz, 2)
