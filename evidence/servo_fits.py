"""Friction laws of BAM, fitted alike to records of a servo with a pendulum by the error of free runs under the command.

The laws are those of Duclusaud, Passault, Padois, Ly, ICRA 2025, and of bam/model.py of Rhoban/bam.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.optimize import least_squares

from daq import FloatArray

STEP_S, EVERY, G = 1e-3, 5, 9.81
MASS_KG, ARM_M = 0.49, 0.1
"""Of the pendulum on the servo."""
NAMES = ("strength", "braking", "armature", "offset", "base", "viscous", "stribeck", "speed", "alpha", "motor",
         "external", "motor_stribeck", "external_stribeck", "motor_quad", "external_quad", "delay")
LAWS = {"Coulomb, viscous (m1)": 6, "and Stribeck (m2)": 9, "and by load (m6)": 15, "and delay": 16}
"""Law -> how many of NAMES it has."""
BEGIN = np.array([0.09, 0.03, 0.002, 0.02, 0.005, 0.01, 0.004, 1.0, 1.5, 0.2, 0.1, 0.02, 0.05, 0.005, 0.005, 0.003])
MOST = np.array([1.0, 1.0, 0.02, 0.2, 0.2, 0.2, 0.2, 10.0, 10.0, 0.9, 0.9, 0.9, 0.9, 0.1, 0.1, 0.05])


class Run(NamedTuple):
    """One record on a grid of STEP_S."""

    goal: FloatArray
    volts: FloatArray
    on: FloatArray
    gain: float
    angle: FloatArray
    """At each EVERY-th step"""


@njit
def _simulated(p, goal, volts, on, gain, q):  # type: ignore[no-untyped-def]
    out, v, inertia, late = np.empty(-(-goal.size // EVERY)), 0.0, MASS_KG * ARM_M**2 + p[2], p[15] / STEP_S
    for k in range(goal.size):
        if k % EVERY == 0:
            out[k // EVERY] = q
        at = max(k - late, 0.0)
        first, motor = int(at), 0.0
        told = goal[first] + (at - first) * (goal[min(first + 1, goal.size - 1)] - goal[first])
        if on[k] > 0.5:
            wanted = p[0] * volts[k] * gain * (told - q)
            motor = min(max(wanted, -p[0] * volts[k]), p[0] * volts[k]) - p[1] * v
        load = -MASS_KG * G * ARM_M * np.sin(q + p[3])
        near = np.exp(-((abs(v) / p[7]) ** p[8]))
        loss = p[4] + near * p[6] + abs(load * p[10] - motor * p[9]) + near * abs(load * p[12] - motor * p[11])
        if load * motor < 0.0:
            loss += near * (p[14] * load**2 if abs(load) < abs(motor) else p[13] * motor**2)
        loss += p[5] * abs(v)
        net = motor + load
        stop = -(inertia * v / STEP_S + net)
        v += STEP_S / inertia * (net + min(max(stop, -loss), loss))
        q += STEP_S * v
    return out


def errors(p: FloatArray, run: Run) -> FloatArray:
    """(N,) error [rad] of a free run from the first reading at rest."""
    found = _simulated(p, run.goal, run.volts, run.on, run.gain, run.angle[0])
    return np.clip(np.nan_to_num(found[: run.angle.size] - run.angle, nan=2.0), -2.0, 2.0)


def rms(p: FloatArray, runs: Sequence[Run]) -> list[float]:
    """Root mean square of the errors of each run [rad]."""
    return [float(np.sqrt(np.mean(errors(p, run) ** 2))) for run in runs]


def fitted(runs: Sequence[Run], count: int) -> FloatArray:
    """(16,) values of NAMES by the least error of free runs, the first `count` of them free."""
    best, found = np.inf, BEGIN
    for sign in (1.0, -1.0):
        base = np.where(np.arange(16) < count, BEGIN, 0.0)
        base[7:9] = base[7:9] if count > 8 else 1.0
        base[3] *= sign

        def left(x: FloatArray, base: FloatArray = base) -> FloatArray:
            return np.concatenate([errors(np.append(x, base[count:]), run) for run in runs])

        low = np.where(np.arange(count) == 3, -0.2, np.where(np.isin(np.arange(count), (7, 8)), 0.01, 0.0))
        low[0] = 1e-3
        one = least_squares(left, base[:count], bounds=(low, MOST[:count]), loss="soft_l1", f_scale=0.1,
                            x_scale=np.maximum(0.5 * np.abs(base[:count]), 1e-4), max_nfev=60, diff_step=[1e-3])
        if one.cost < best:
            best, found = float(one.cost), np.append(one.x, base[count:])
    return found


def run_of(time_s: FloatArray, goal: FloatArray, volts: FloatArray, on: FloatArray, angle: FloatArray, gain: float
           ) -> Run:
    """One record on the grid."""
    t = time_s - time_s[0]
    fine = np.arange(int(t[-1] / STEP_S)) * STEP_S
    return Run(np.interp(fine, t, goal), np.interp(fine, t, volts), np.interp(fine, t, on), gain,
               np.interp(fine[::EVERY], t, angle))


def published(values: Mapping[str, float], sign: float) -> FloatArray:
    """(16,) values of the XL330 as BAM publishes them."""
    strength = values["kt"] / values["R"]
    theirs = {"armature": "armature", "speed": "dtheta_stribeck", "alpha": "alpha",
              **{name: f"friction_{name}" for name in ("base", "viscous", "stribeck")}}
    own = {name: values.get(theirs.get(name, f"load_friction_{name}"), float(name in ("speed", "alpha")))
           for name in NAMES}
    own |= {"strength": strength, "braking": strength * values["kt"], "offset": sign * values["q_offset"]}
    return np.array([own[name] for name in NAMES])

