"""Unknown friction torque near rest of every joint of a record, and its smoothing velocity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from daq import FloatArray
from estimator.likelihood.dry_friction import (
    REST_SPREAD,
    crossing_samples,
    draw_held,
    held_variance,
    likeliest_smoothing,
)
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import Latents
from estimator.likelihood.state import State
from estimator.likelihood.trajectory_likelihood import LatentProblem
from estimator.model import Mechanism

KINK = 2.0
"""See `find_stiction`."""


def find_stiction(problem: LatentProblem, v: FloatArray, beta: FloatArray, one_per_crossing: bool = True
                  ) -> FloatArray:
    """(N, 2, n) what dry friction leaves open at each sample, and in the interval from it on, squared [N^2 m^2].

    At samples see `dry_friction`; friction is one draw a zero crossing of the velocity, or one a sample.
    (Measured on a leg that starts at rest against a spring: without this the spring's preload is 6 % off and five
    parameters 0.25 %, with it 0.7 % and 0.05 %.)
    In an interval at whose ends a joint is slower than what friction can change its rate by in KINK intervals, or in
    which it turns round, it may rest or reverse, nothing says when, and the sums of friction over it are free up to F:
    what such an interval says of beta is little, and wrong. (Measured on an event-driven leg with friction of a tenth
    of the torque's peak at 100 Hz: the knee's Coulomb level 4.4 to 5.6 of its standard deviations low without this and
    a smooth torque, 0.1 to 1.2 with them, in half as many steps.)
    """
    m = problem.mechanism
    out = np.zeros((problem.total, 2, problem.n))
    for k, j in _coulomb(m):
        scale = float(m.velocity_scales[j])
        out[:, 0, j] += held_variance(v[:, j], beta[k], scale)
        if one_per_crossing:
            out[:, 0, j] *= crossing_samples(v[:, j], scale, problem.ends)
        inertia = float(problem.inertia_rows[:, j] @ beta[: m.p])
        slow = REST_SPREAD * problem.sharpest[j]
        slow += KINK * abs(beta[k]) * problem.dt / inertia if inertia > 0.0 else 0.0
        before, later = v[problem.left, j], v[problem.left + 1, j]
        open_ = (before * later < 0.0) | (np.minimum(np.abs(before), np.abs(later)) < slow)
        out[problem.left, 1, j] += beta[k] ** 2 * open_
    return out


def draw_stiction(problem: LatentProblem, state: State, share: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(N, n) torque [N m] held by dry friction near rest: one draw a zero crossing, `share` (n,) of the most."""
    out = np.zeros((problem.total, problem.n))
    for k, j in _coulomb(problem.mechanism):
        level, scale = float(share[j] * state.beta[k]), float(problem.mechanism.velocity_scales[j])
        out[:, j] += draw_held(state.x.v[:, j], level, scale, problem.ends, rng)
    return out


def find_smoothing(problem: LatentProblem, x: Latents, beta: FloatArray, noise: Noise, residual: FloatArray,
                   spread: FloatArray) -> FloatArray:
    """(n,) likeliest velocity [rad/s] over which each joint's sign of friction is smoothed.

    `residual` and `spread` (N, n) are the torques', and their variance by the latents.
    """
    found = problem.mechanism.velocity_scales.copy()
    for k, j in _coulomb(problem.mechanism):
        found[j] = likeliest_smoothing(x.v[:, j], beta[k], problem.sharpest[j], found[j], noise.torque[j],
                                       residual[:, j], spread[:, j])
    return found


def _coulomb(mechanism: Mechanism) -> Iterator[tuple[int, int]]:
    """Number of each Coulomb level among the parameters, and its joint."""
    return ((k, p.at[0]) for k, p in enumerate(mechanism.parameters) if p.term == "coulomb")
