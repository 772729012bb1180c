"""A leg of MuJoCo that is let go and swings out, no motor on it: its own dynamics, nothing of the estimator's."""

import mujoco
import numpy as np

from daq import Dataset
from tests.support.mujoco_leg import Leg


def swing(leg: Leg, rng: np.random.Generator, start: tuple[float, float], *, seconds: float = 20.0,
          quadratic: float = 0.0, torque: bool = True) -> Dataset:
    """One swing from rest at `start` [rad]; `quadratic` is a drag on the knee [N m s^2/rad^2].

    `torque` gives a column of zeros, or none.
    """
    model = leg.model(1e-3)
    data = mujoco.MjData(model)
    data.qpos[:] = start
    n = int(seconds * 100.0)
    rows, coulomb = np.empty((n, 2)), np.array(leg.coulomb)
    for k in range(n):
        rows[k] = data.qpos
        for _ in range(10):
            data.qfrc_applied[:] = -coulomb * np.tanh(data.qvel / 0.02)
            data.qfrc_applied[1] -= quadratic * data.qvel[1] * abs(data.qvel[1])
            mujoco.mj_step(model, data)
    rows += 2e-4 * rng.normal(size=rows.shape)
    columns = {"q1_rad": rows[:, 0].copy(), "q2_rad": rows[:, 1].copy()} | ({"tau2_nm": np.zeros(n)} if torque else {})
    return Dataset("swing", 100.0, np.arange(n) / 100.0, columns)
