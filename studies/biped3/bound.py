"""The Cramer-Rao bound of a study's case, with exact motion and exact relative angles.

`cramer_rao` needs some noise on everything it reads; here what is exact stays exact. The unknowns are the
first state, the true torques and beta; the flow's derivative by them comes from differencing the integrator that
made the data; exact angles are constraints, and the bound is taken on their null space.
"""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.model import Mechanism
from studies.rk4_free_run import advance
from studies.walker import Step

SUBSTEPS = 4
NUDGE = 1e-6
NULL = 1e-11
"""Singular values of the constraints below this share of the largest are null."""


def exact_bound(mechanism: Mechanism, beta: FloatArray, step: Step, angle_variance: float,
                torque_variance: float) -> FloatArray:
    """Smallest covariance (p, p) of beta: q1 with white noise, other angles exact, torques of the motors with noise."""
    samples, n, p = len(step.time_s), mechanism.n, mechanism.p
    drives = list(mechanism.actuated)
    states, inputs = 2 * n, len(drives) * (samples - 1)
    unknown = states + inputs + p
    size = np.concatenate([np.ones(states + inputs), np.abs(beta)])
    by_unknown = np.zeros((states, unknown))
    by_unknown[:, :states] = np.eye(states)
    angles = [by_unknown[:n].copy()]
    for k in range(samples - 1):
        slope = _flow_slope(mechanism, beta, step, k, drives)
        own = np.zeros((states + len(drives) + p, unknown))
        own[:states] = by_unknown
        first = states + k * len(drives)
        own[states : states + len(drives), first : first + len(drives)] = np.eye(len(drives))
        own[states + len(drives) :, -p:] = np.eye(p)
        by_unknown = slope @ own
        angles.append(by_unknown[:n].copy())
    stacked = np.array(angles) * size  # (N, n, unknown)
    exact = stacked[:, 1:].reshape(-1, unknown)
    exact = exact / np.linalg.norm(exact, axis=1, keepdims=True)
    _, values, vectors = np.linalg.svd(exact)
    null = vectors[int(np.sum(values > NULL * values[0])) :].T
    torque = np.eye(unknown)[states : states + inputs] / np.sqrt(torque_variance)
    jacobian = np.vstack([stacked[:, 0] / np.sqrt(angle_variance), torque]) @ null
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    shown = (size[:, None] * null)[-p:]
    bound: FloatArray = shown @ covariance @ shown.T
    return bound


def _flow_slope(mechanism: Mechanism, beta: FloatArray, step: Step, k: int, drives: list[int]) -> FloatArray:
    """d(state at k + 1)/d(state at k, torques held from k, beta), by central differences; torque by unit."""
    n = mechanism.n
    at = np.concatenate([step.q[k], step.qd[k], step.torque[k, drives], beta])
    nudge = NUDGE * np.concatenate([np.ones(2 * n + len(drives)), np.abs(beta)])
    moved = at + np.concatenate([np.diag(nudge), -np.diag(nudge)])
    torque = np.zeros((len(moved), n))
    torque[:, drives] = moved[:, 2 * n : 2 * n + len(drives)]
    q, qd = advance(mechanism, moved[:, 2 * n + len(drives) :], moved[:, :n], moved[:, n : 2 * n], torque,
                    float(step.time_s[k + 1] - step.time_s[k]), SUBSTEPS)
    state = np.concatenate([q, qd], axis=1)
    slope: FloatArray = ((state[: at.size] - state[at.size :]) / (2.0 * nudge[:, None])).T
    return slope
