"""A joint behind a position loop: a pendulum of known parameters that follows a command."""

import numpy as np

from daq import Dataset

INERTIA, MOMENT, VISCOUS, GAIN, DAMPING = 0.02, 0.05, 0.03, 4.0, 0.1
"""kg m^2, kg m, N m s/rad, N m/rad, N m s/rad"""


def servo_run(name: str = "run", *, seed: int = 1, seconds: float = 12.0, rate_hz: float = 100.0) -> Dataset:
    """`q1_rad` and `q1_cmd_rad` (n,) of a loop at 1 kHz, its command a sum of three sines."""
    rng = np.random.default_rng(seed)
    sub, n = round(1000.0 / rate_hz), int(seconds * rate_hz)
    t = np.arange(n * sub) / 1000.0
    command = sum(a * np.sin(2.0 * np.pi * f * t + p) for a, f, p in zip(
        (0.6, 0.4, 0.2), (0.31, 0.83, 1.7), rng.uniform(0.0, 6.28, 3)))
    rows, q, v = np.empty((n, 2)), float(command[0]), 0.0
    for k, wanted in enumerate(command):
        if k % sub == 0:
            rows[k // sub] = q, wanted
        torque = GAIN * (wanted - q) - DAMPING * v - VISCOUS * v - 9.81 * MOMENT * np.sin(q)
        v += 1e-3 * torque / INERTIA
        q += 1e-3 * v
    angle = rows[:, 0] + rng.normal(0.0, 2e-4, n)
    return Dataset(name, rate_hz, np.arange(n) / rate_hz, {"q1_rad": angle, "q1_cmd_rad": rows[:, 1].copy()})
