"""An independent pendulum behind a gear of 100:1, with the errors that such a drive has and no fit knows of.

The encoder sits on the motor. Its angle over the gear ratio differs from the link's by the gear's own error, periodic
in the motor's angle. Friction wanders by an Ornstein-Uhlenbeck process. The motor follows a multisine by a position
controller. Integration is the midpoint rule at 4 kHz; nothing of the estimator's motion model is in here.
"""

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from daq import Dataset
from tests.support.mujoco_leg import GRAVITY, multisine

STEP_S = 2.5e-4
RATE_HZ = 100.0
PERIODS = 2.0
"""Of the gear's error, a turn of the motor: what a wave gear makes."""
STIFFNESS, DAMPING = 60.0, 6.0
"""Of the position controller [N m/rad, N m s/rad]."""
ROUNDING = 0.005
"""Speed over which friction turns round [rad/s]."""


@dataclass(frozen=True)
class GearedPendulum:
    """Its truth [SI], rotor included, at the joint."""

    inertia: float = 0.18
    moment: float = 0.9
    """m lc [kg m]"""
    viscous: float = 0.3
    coulomb: float = 1.2
    gear_error: float = 1.5e-3
    """Amplitude [rad], at the joint."""
    ratio: float = 100.0
    wander: float = 0.3
    """Standard deviation of what friction wanders by [N m], ..."""
    wander_s: float = 0.05
    """... and its time constant [s]."""

    def beta(self) -> np.ndarray:
        return np.array([self.inertia, self.moment, self.viscous, self.coulomb])


@numba.njit(cache=True)
def _simulate(reference: Any, rate: Any, wander: Any, beta: Any, rows: Any) -> None:
    """rows (T, 2): angle, and torque of the motor."""
    q, v, h = reference[0], rate[0], STEP_S
    for k in range(reference.size):
        u = STIFFNESS * (reference[k] - q) + DAMPING * (rate[k] - v)
        rows[k, 0], rows[k, 1] = q, u
        qm, vm = q, v
        for i in range(2):
            friction = (beta[3] * np.tanh(vm / ROUNDING) + wander[k]) + beta[2] * vm
            a = (u - friction - beta[1] * GRAVITY * np.sin(qm)) / beta[0]
            f = 0.5 * h if i == 0 else h
            vn = v + f * a
            qm, vm = q + f * (0.5 * (v + vn) if i else v), vn
        q, v = qm, vm


def record(pendulum: GearedPendulum, rng: np.random.Generator, *, seconds: float = 30.0, torque: float = 0.05,
           encoder: float = 2e-5, amplitude: float = 0.8, name: str = "run") -> Dataset:
    """One run on the recorder's grid: the motor's angle over the ratio, and torque, with white noise."""
    time = np.arange(round(seconds / STEP_S)) * STEP_S
    reference = multisine(rng, time, amplitude, low=0.1, high=2.0)
    keep = np.exp(-STEP_S / pendulum.wander_s)
    kicks = pendulum.wander * np.sqrt(1.0 - keep**2) * rng.normal(size=time.size)
    wander = np.empty_like(kicks)
    x = 0.0
    for k, kick in enumerate(kicks):
        wander[k] = x = keep * x + kick
    rows = np.empty((time.size, 2))
    _simulate(reference, np.gradient(reference, STEP_S), wander, pendulum.beta(), rows)
    q, u = rows[:: round(1.0 / (RATE_HZ * STEP_S))].T
    n = len(q)
    shown = q + pendulum.gear_error * np.sin(PERIODS * pendulum.ratio * q + 1.0)
    return Dataset(name, RATE_HZ, np.arange(n) / RATE_HZ, {
        "q1_rad": shown + encoder * rng.normal(size=n), "tau1_nm": u + torque * rng.normal(size=n)})
