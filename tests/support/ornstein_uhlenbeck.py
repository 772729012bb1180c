"""A coloured disturbance torque drawn by its definition, and a leg's record under it."""

from dataclasses import replace

import numpy as np

from daq import Dataset, FloatArray
from tests.support.mujoco_leg import Leg, multisine, record


def draw(rng: np.random.Generator, count: int, level: float, time_constant_s: float, dt: float) -> FloatArray:
    """(count,) of standard deviation `level` whose correlation is exp(-|t| / T)."""
    decay = np.exp(-dt / time_constant_s)
    steps = level * np.sqrt(1.0 - decay**2) * rng.normal(size=count)
    out = np.empty(count)
    out[0] = level * rng.normal()
    for k in range(1, count):
        out[k] = decay * out[k - 1] + steps[k]
    return out


def disturbed_record(leg: Leg, rng: np.random.Generator, level: float, time_constant_s: float, name: str = "run"
                     ) -> Dataset:
    """MuJoCo's leg at 100 Hz whose knee feels the disturbance, which its shunt does not read."""
    time = np.arange(2000) / 100.0
    disturbance = draw(rng, 2000, level, time_constant_s, 0.01)
    made = record(leg, rng, seconds=20.0, tau=multisine(rng, time, 1.2) + disturbance, name=name)
    return replace(made, columns={**made.columns, "tau2_nm": made["tau2_nm"] - disturbance})
