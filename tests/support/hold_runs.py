"""Runs of a leg that a staircase of torques brings to rest, in closed form: no code under test makes them.

So slowly that nothing has inertia, the shank's moment G sin(theta) follows the torque less friction (a play operator),
and the free pivot hangs where both links balance: beta4 sin q1 + beta5 sin theta = 0.
"""

from dataclasses import dataclass

import numpy as np

from daq import Dataset
from experiments.excite import staircase

G = 9.81
RATE_HZ = 100.0


@dataclass(frozen=True)
class Truth:
    """A leg [SI] whose drive makes `gain` times the torque that it believes to make."""

    gain: float = 1.07
    beta4: float = 0.43
    beta5: float = 0.105
    coulomb: float = 0.04
    load_friction: float = 0.0
    """More friction, as a share of the weight's moment at a right angle."""
    knee_zero_rad: float = 0.0
    offset_nm: float = 0.0


def hold_run(truth: Truth, rng: np.random.Generator, mass_kg: float = 0.0, columns: str = "imu") -> Dataset:
    """One staircase, with a mass on link 2 or without."""
    plan = staircase(0.8, 4)
    command = plan.torque_nm
    moment = (truth.beta5 + mass_kg * 0.25) * G
    friction = truth.coulomb + truth.load_friction * mass_kg * 0.25 * G
    carried, follows = np.empty(command.size), 0.0
    for k, torque in enumerate(truth.gain * command):
        follows = min(max(follows, torque - friction), torque + friction)
        carried[k] = follows
    theta = np.arcsin(carried / moment)
    # the pivot carries the same shank; a mass at r on link 2 pulls at its end by m l1 too, l1 = 0.3
    q1 = -np.arcsin(carried / G / (truth.beta4 + mass_kg * 0.3))
    found = {"q2_rad": theta - q1 + truth.knee_zero_rad + 2e-4 * rng.standard_normal(theta.size),
             "tau2_nm": command + truth.offset_nm + 0.01 * rng.standard_normal(theta.size),
             "tau2_cmd_nm": command}
    if columns == "imu":
        found |= {"gyro_radps": 0.005 * rng.standard_normal(theta.size),
                  "accel_x_mps2": G * np.sin(q1) + 0.05 * rng.standard_normal(theta.size),
                  "accel_y_mps2": -G * np.cos(q1) + 0.05 * rng.standard_normal(theta.size)}
    else:
        found["q1_rad"] = q1 + 7e-4 * rng.standard_normal(theta.size)
    return Dataset("weighted" if mass_kg else "bare", RATE_HZ, plan.time_s, found)
