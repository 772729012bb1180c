"""A leg of MuJoCo whose knee is a position servo at 1 kHz, logged with its command and without its torque."""

from __future__ import annotations

import mujoco
import numpy as np

from daq import Dataset
from tests.support.mujoco_leg import Leg, multisine

COUNTS = 4096


def follow(leg: Leg, rng: np.random.Generator, *, gain: float, damping: float = 0.0, limit: float = np.inf,
           amplitude: float = 0.8, seconds: float = 15.0, rate_hz: float = 100.0, rounding: float = 0.02,
           name: str = "run") -> Dataset:
    """The servo gives gain (cmd - q) - damping qd within +-limit, by its own encoder of COUNTS a turn."""
    model = leg.model(1e-3)
    data = mujoco.MjData(model)
    n, sub = int(seconds * rate_hz), round(1000.0 / rate_hz)
    ticks = np.arange(n * sub) / 1000.0
    command = multisine(rng, ticks, amplitude, high=2.0)
    rows, grid, coulomb = np.empty((n, 3)), 2.0 * np.pi / COUNTS, np.array(leg.coulomb)
    for k in range(n * sub):
        read = np.round(data.qpos / grid) * grid
        if k % sub == 0:
            rows[k // sub] = *read, command[k]
        torque = gain * (command[k] - read[1]) - damping * data.qvel[1]
        data.qfrc_applied[:] = -coulomb * np.tanh(data.qvel / rounding)
        data.qfrc_applied[1] += np.clip(torque, -limit, limit)
        mujoco.mj_step(model, data)
    columns = dict(zip(("q1_rad", "q2_rad", "q2_cmd_rad"), np.ascontiguousarray(rows.T)))
    return Dataset(name, rate_hz, np.arange(n) / rate_hz, columns)
