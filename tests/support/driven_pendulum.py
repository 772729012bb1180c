"""Runs of a driven pendulum that may feel more than its nominal model knows: short, for whole diagnoses in seconds."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from daq import Dataset, FloatArray
from estimator.model import Mechanism, joint1

RATE_HZ, SECONDS = 50.0, 6.0
BETA = np.array([0.05, 0.12, 0.04, 0.03])
"""Inertia [kg m^2], m lc [kg m], viscous [N m s/rad] and dry friction [N m]."""
SMOOTHING = 0.05
"""Friction has its full level from about this speed on [rad/s]."""


def mechanism() -> Mechanism:
    return joint1(velocity_scale=SMOOTHING)


def pendulum_run(name: str, seed: int, drag: float = 0.0, spring: float = 0.0) -> Dataset:
    """`drag` [N m s^2/rad^2] with the square of its speed, `spring` [N m/rad] about its lowest point."""
    rng = np.random.default_rng(seed)
    grid = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    tones = rng.uniform(1.0, 9.0, 4), rng.uniform(0.0, 2.0 * np.pi, 4)
    torque: FloatArray = (0.4 + 0.1 * rng.random()) * np.sum(np.sin(np.outer(grid, tones[0]) + tones[1]), axis=1)
    inertia, moment, viscous, coulomb = BETA

    def rates(t: float, y: FloatArray) -> list[float]:
        load = 9.81 * moment * np.sin(y[0]) + spring * y[0]
        lost = viscous * y[1] + coulomb * np.tanh(y[1] / SMOOTHING) + drag * y[1] * abs(y[1])
        return [y[1], (np.interp(t, grid, torque) - load - lost) / inertia]

    q = solve_ivp(rates, (0.0, grid[-1]), [0.0, 0.0], t_eval=grid, rtol=1e-7, atol=1e-9, max_step=5e-3).y[0]
    return Dataset(name, RATE_HZ, grid, {"q1_rad": q + 2e-4 * rng.normal(size=q.size),
                                         "tau1_nm": torque + 0.005 * rng.normal(size=q.size)})


def pendulum_runs(count: int, **hidden: float) -> list[Dataset]:
    return [pendulum_run(f"r{k}", 70 + k, **hidden) for k in range(count)]
