"""Unknown friction torque near rest of every joint of a record, and its smoothing velocity."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.likelihood.dry_friction import (
    REST_SPREAD,
    crossing_samples,
    draw_held,
    held_variance,
    likeliest_smoothing,
)
from estimator.likelihood.latent_problem import LatentProblem
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import Latents
from estimator.likelihood.state import State

KINK = 2.0
"""See `find_stiction`."""


def find_stiction(problem: LatentProblem, v: FloatArray, beta: FloatArray, one_per_crossing: bool = True
                  ) -> FloatArray:
    """(N, 2, n) variance [N^2 m^2] of the unknown friction torque at each sample, and in the interval after it.

    - At samples see `dry_friction`: one value for each zero crossing of the velocity, or one for each sample.
    - In an interval the variance is F^2 if the joint reverses in it, or if |v| < KINK dt F / M at one of its ends.

    (Measured: the spring's preload of a leg that starts at rest is 0.7 % off, without this 6 %. The knee's Coulomb
    level of an event-driven leg at 100 Hz is 0.1 to 1.2 standard deviations low, without this 4.4 to 5.6.)
    """
    m = problem.mechanism
    out = np.zeros((problem.total, 2, problem.n))
    for j, level in problem.dry_levels(beta).items():
        scale = float(m.velocity_scales[j])
        out[:, 0, j] += held_variance(v[:, j], level, scale)
        if one_per_crossing:
            out[:, 0, j] *= crossing_samples(v[:, j], scale, problem.ends)
        inertia = float(m.inertia_rows[:, j] @ beta[: m.p])
        slow = REST_SPREAD * problem.sharpest[j]
        slow += KINK * abs(level) * problem.dt / inertia if inertia > 0.0 else 0.0
        before, later = v[problem.left, j], v[problem.left + 1, j]
        open_ = (before * later < 0.0) | (np.minimum(np.abs(before), np.abs(later)) < slow)
        out[problem.left, 1, j] += level**2 * open_
    return out


def draw_stiction(problem: LatentProblem, state: State, share: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(N, n) torque [N m] held by dry friction near rest: one draw a zero crossing, `share` (n,) of the most."""
    out = np.zeros((problem.total, problem.n))
    for j, level in problem.dry_levels(state.beta).items():
        scale = float(problem.mechanism.velocity_scales[j])
        out[:, j] += draw_held(state.x.v[:, j], float(share[j]) * level, scale, problem.ends, rng)
    return out


def find_smoothing(problem: LatentProblem, x: Latents, beta: FloatArray, noise: Noise, residual: FloatArray,
                   spread: FloatArray) -> FloatArray:
    """(n,) likeliest velocity [rad/s] over which each joint's sign of friction is smoothed.

    `residual` and `spread` (N, n) are the torques', and their variance by the latents.
    """
    found = problem.mechanism.velocity_scales.copy()
    for j, level in problem.dry_levels(beta).items():
        found[j] = likeliest_smoothing(x.v[:, j], level, problem.sharpest[j], found[j], noise.torque[j],
                                       residual[:, j], spread[:, j])
    return found

