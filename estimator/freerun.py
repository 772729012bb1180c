"""Free-run simulation of a model with effects, and what its sensors would read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.extended import ExtendedProblem
from estimator.gauss_newton import State
from estimator.latent import Latents
from estimator.sensors import accelerometer
from estimator.simulation import simulate

FloatArray = NDArray[np.float64]
PASSES = 60
SETTLED_RAD = 2e-5


@dataclass(frozen=True)
class FreeRun:
    """Motion from each stretch's first state and the torque alone."""

    q: FloatArray
    """(N, n)"""
    v: FloatArray
    readings: Mapping[str, FloatArray]
    """Channel to (N,), noise free."""


def free_run(problem: ExtendedProblem, state: State, torque: FloatArray | None = None) -> FreeRun | None:
    """Simulate every stretch; None where it diverges.

    `torque` (N, n) drives it, by default the true torque in `state`. What effects add to the equation of
    motion is found by repeated simulation, each with the effects' torque of the one before.
    """
    m, c = problem.mechanism, problem.collocation
    beta, sizes = problem.split(state.beta)
    u = state.x.u if torque is None else torque
    q, v = state.x.q.copy(), state.x.v.copy()
    parts = np.split(np.arange(problem.total), problem.ends[:-1])
    added_gauss = np.zeros((m.n, 2, problem.left.size))
    added = np.zeros((m.n, problem.total))
    share, before = 1.0, np.inf
    for _ in range(PASSES):
        x = Latents(q, v, u)
        if problem.effects:
            new_gauss, new, _ = problem.added(problem.view(x, beta, added), sizes)
            added_gauss += share * (new_gauss - added_gauss)
            added += share * (new - added)
        next_q, next_v = np.empty_like(q), np.empty_like(v)
        for where in parts:
            here = np.flatnonzero((problem.left >= where[0]) & (problem.left < where[-1]))
            next_q[where], next_v[where], _ = simulate(
                m, beta, state.x.q[where[0]], state.x.v[where[0]], u[where], c.dt, c.hold,
                guess=(q[where], v[where]), taken=added_gauss[:, :, here])
        if not np.isfinite(next_q).all():
            return None
        moved = float(np.max(np.abs(next_q - q)))
        q, v = next_q, next_v
        if not problem.effects or moved < SETTLED_RAD:
            break
        if moved > 0.9 * before:
            share = max(0.2, 0.7 * share)
        before = moved
    else:
        if moved > 0.02:
            return None
    view = problem.view(Latents(q, v, u), beta, added)
    s = view.samples
    readings = {f"torque{j + 1}": u[:, j].copy() for j in range(m.n)}
    readings |= {f"encoder{j + 1}": q[:, j].copy() for j in range(m.n)}
    ax, ay = accelerometer(s.q[0], s.v[0], s.a[0], m.lever_arm, m.gravity_mps2)
    readings |= {"gyro": v[:, 0].copy(), "accel_x": ax, "accel_y": ay}
    for effect, size in zip(problem.effects, sizes):
        for channel, value in effect.perturb(view, size).readings.items():
            readings[channel] = readings[channel] + value
    return FreeRun(q, v, readings)
