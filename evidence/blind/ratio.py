"""How far a leg with a hidden effect leaves the plain leg's free run, in units of that run's own floor.

The floor is what process torque and shunt noise alone make of a free run. A fit can move the nine parameters and
each run's initial state; to first order it removes from both errors what lies in their span, so the ratio is
that of what is projected.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from evidence.blind.leg import Array, Leg
from evidence.blind.measure import Sensors, imu
from evidence.blind.physics import integrate

CHANNELS = ("q2_rad", "gyro_radps", "accel_x_mps2", "accel_y_mps2")
MOVED = ("i1", "i2", "l1", "c1", "c2", "viscous1", "viscous2", "coulomb1", "coulomb2")
EVERY = 4
_NUDGE = 2e-3


def sensitivities(leg: Leg, torque: Array) -> Array:
    """Slopes of the four sensors on parameters and initial state, (13, R, 4, N/EVERY); `torque` is (N, R).

    The five inertial nudges are physical (`MOVED`); they span the same changes as beta1 .. beta5.
    """
    runs = torque.shape[1]
    legs = [leg] + [replace(leg, **{name: getattr(leg, name) * (1.0 + _NUDGE)}) for name in MOVED] + [leg] * 4
    count = len(legs)
    joined = Leg(**{name: np.concatenate([np.asarray(getattr(x, name)) for x in legs])
                    for name in Leg.__dataclass_fields__})
    start = np.zeros((4, count, runs))
    for j in range(4):
        start[j, 1 + len(MOVED) + j] = _NUDGE
    motion = integrate(joined, np.tile(torque, (1, count)), start=start.reshape(4, -1), step=2.5e-3)
    still = np.zeros_like(motion.q1)
    gyro, ax, ay = imu(motion.q1, motion.w1, motion.a1, still, still, Sensors.lever)
    seen = np.stack([motion.q2, gyro, ax, ay])[:, ::EVERY].reshape(4, -1, count, runs)
    moved = (seen[:, :, 1:] - seen[:, :, :1]) / _NUDGE
    return np.ascontiguousarray(moved.transpose(2, 3, 0, 1))


def error_ratio(measured: Sequence[Mapping[str, Array]], plain: Sequence[Mapping[str, Array]],
                bare: Sequence[Mapping[str, Array]], slopes: Array, sensors: Sensors) -> float:
    """Largest projected ratio over the sensors. Columns are noise free."""
    sigma = np.array([sensors.count_rad / np.sqrt(12.0), sensors.gyro, sensors.accel, sensors.accel])[:, None]

    def differ(a: Sequence[Mapping[str, Array]]) -> Array:
        return np.array([[x[c][::EVERY] - p[c][::EVERY] for c in CHANNELS] for x, p in zip(a, plain)])

    error, floor = differ(measured), differ(bare)
    level = np.sqrt(np.mean(floor**2, axis=(0, 2)) + sigma[:, 0]**2)[:, None]
    # columns: nine parameters common to the runs, four initial states for each run
    columns = [(s / level).reshape(-1) for s in slopes[:9]]
    for run in range(len(measured)):
        for s in slopes[9:]:
            one = np.zeros_like(error)
            one[run] = s[run] / level
            columns.append(one.reshape(-1))
    basis, _ = np.linalg.qr(np.array(columns).T)

    def project(a: Array) -> Array:
        flat = (a / level).reshape(-1)
        return (flat - basis @ (basis.T @ flat)).reshape(a.shape) * level

    power = [np.mean(x**2, axis=(0, 2)) + sigma[:, 0]**2 for x in (project(error), project(floor))]
    return float(np.sqrt(power[0] / power[1]).max())
