"""A leg behind a position loop in three simulators: the equations of motion by hand, Pinocchio and MuJoCo.

The first two are integrated by Runge-Kutta of fourth order, MuJoCo by its own. Friction is a torque in all.
"""

import importlib
import importlib.util
import math
from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np

from daq import Dataset, FloatArray
from tests.support import runge_kutta
from tests.support.engine_leg import Pinocchio
from tests.support.mujoco_leg import GRAVITY, Leg, multisine
from tests.support.servo_leg import COUNTS, Servo, ServoFaults

STEP_S = 5e-4
ROUNDING_RADPS = 0.02
"""Velocity over which dry friction turns."""
Acceleration = Callable[[FloatArray, FloatArray, float], FloatArray]
Step = Callable[[FloatArray, FloatArray, float], tuple[FloatArray, FloatArray]]
"""Places and velocities (2,) a step later, under a torque at the knee."""


class Loop(NamedTuple):
    """A position loop as it is."""

    gain: float
    damping: float
    limit: float
    tick_hz: float
    delay_s: float
    """Of its command; the loop ticks whether or not that is a whole number of ticks."""


def friction(leg: Leg, v: FloatArray) -> FloatArray:
    """(2,) torque against the motion [N m]."""
    return np.array(leg.viscous) * v + np.array(leg.coulomb) * np.tanh(v / ROUNDING_RADPS)


def by_hand(leg: Leg) -> Step:
    """The two equations of motion, solved for the accelerations."""
    b = leg.beta()

    def acceleration(q: FloatArray, v: FloatArray, torque: float) -> FloatArray:
        c, s = math.cos(q[1]), math.sin(q[1])
        d11, d12, d22 = b[0] + b[1] + 2 * b[2] * c, b[1] + b[2] * c, b[1]
        below, taken = b[4] * GRAVITY * math.sin(q[0] + q[1]), friction(leg, v)
        t1 = b[2] * s * (2 * v[0] * v[1] + v[1] ** 2) - b[3] * GRAVITY * math.sin(q[0]) - below - taken[0]
        t2 = torque - b[2] * s * v[0] ** 2 - below - taken[1]
        return np.array([d22 * t1 - d12 * t2, d11 * t2 - d12 * t1]) / (d11 * d22 - d12**2)

    return _integrated(acceleration)


def pinocchio(leg: Leg) -> Step:
    """Accelerations by Pinocchio's articulated-body algorithm."""
    engine = Pinocchio(leg)
    return _integrated(lambda q, v, torque: engine.acceleration(q, v, np.array([0.0, torque]) - friction(leg, v)))


def _integrated(acceleration: Acceleration) -> Step:
    return lambda q, v, torque: runge_kutta.step(lambda q, v: acceleration(q, v, torque), q, v, STEP_S)[:2]


def in_mujoco(leg: Leg) -> Step:
    """MuJoCo's own steps."""
    model = leg.model(STEP_S)
    data, coulomb = mujoco.MjData(model), np.array(leg.coulomb)

    def step(q: FloatArray, v: FloatArray, torque: float) -> tuple[FloatArray, FloatArray]:
        data.qfrc_applied[:] = -coulomb * np.tanh(v / ROUNDING_RADPS)
        data.qfrc_applied[1] += torque
        mujoco.mj_step(model, data)
        return data.qpos.copy(), data.qvel.copy()

    return step


PLANTS = {"by hand": by_hand, "Pinocchio": pinocchio, "MuJoCo": in_mujoco}


def there() -> list[str]:
    """Simulators that are installed."""
    return [name for name in PLANTS if name != "Pinocchio" or importlib.util.find_spec("pinocchio")]


def record(plant: str, leg: Leg, loop: Loop, rng: np.random.Generator, *, log_hz: float, seconds: float,
           amplitude: float, high: float, name: str) -> Dataset:
    """One run as the servo logs it: both angles and the command."""
    step, count = PLANTS[plant](leg), round(seconds / STEP_S)
    command = multisine(rng, np.arange(count) * STEP_S, amplitude, high=high)
    servo = Servo(loop.gain, loop.damping, loop.limit, ServoFaults(), 0, 1.0 / loop.tick_hz)
    every, row, late = (round(s / STEP_S) for s in (1.0 / loop.tick_hz, 1.0 / log_hz, loop.delay_s))
    q, v, grid, torque, rows = np.zeros(2), np.zeros(2), 2.0 * np.pi / COUNTS, 0.0, []
    for k in range(count):
        read = np.round(q / grid) * grid
        if k % row == 0:
            rows.append((*read, command[k]))
        if k % every == 0:
            torque = servo.torque(command[max(k - late, 0)], read[1], v[1])
        q, v = step(q, v, torque)
    columns = dict(zip(("q1_rad", "q2_rad", "q2_cmd_rad"), np.ascontiguousarray(np.array(rows).T)))
    return Dataset(name, log_hz, np.arange(len(rows)) / log_hz, columns)
