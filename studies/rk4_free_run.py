"""Free runs of many models at once under one held torque record, with a verdict for each.

Runge-Kutta on a fixed step, on purpose not the estimator's collocation: what scores the estimates, and makes the
data, shares no integrator with them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.model import Mechanism

RATE_LIMIT = 1e4
"""Rate beyond which a run counts as failed [rad/s]: an integrator with error control has stopped long before."""


class FreeRuns(NamedTuple):
    """R models simulated over N samples."""

    q: FloatArray
    """(R, N, n) [rad]; NaN from where a run failed."""
    failed: NDArray[np.bool_]
    """(R,) the run could not be carried to its end."""


def advance(mechanism: Mechanism, beta: FloatArray, q: FloatArray, qd: FloatArray, torque: FloatArray, dt_s: float,
            substeps: int) -> tuple[FloatArray, FloatArray]:
    """State after `dt_s` under a constant torque; all (..., n), beta (..., p). Classical Runge-Kutta."""
    h = dt_s / substeps
    for _ in range(substeps):
        a1 = mechanism.forward_dynamics(q, qd, torque, beta)
        v2 = qd + 0.5 * h * a1
        a2 = mechanism.forward_dynamics(q + 0.5 * h * qd, v2, torque, beta)
        v3 = qd + 0.5 * h * a2
        a3 = mechanism.forward_dynamics(q + 0.5 * h * v2, v3, torque, beta)
        v4 = qd + h * a3
        a4 = mechanism.forward_dynamics(q + h * v3, v4, torque, beta)
        q = q + h / 6.0 * (qd + 2.0 * v2 + 2.0 * v3 + v4)
        qd = qd + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return q, qd


def free_runs(mechanism: Mechanism, beta: FloatArray, q0: FloatArray, qd0: FloatArray, torque: FloatArray,
              dt_s: float, substeps: int = 4) -> FreeRuns:
    """Models beta (R, p) from the state q0, qd0 (n,) under torque (N, n), each sample held until the next.

    A run fails where a rate passes `RATE_LIMIT` or where the inertia matrix becomes singular on the way (its
    determinant changes sign): there the equations of motion have no solution and an integrator stops.
    """
    count, samples = beta.shape[0], torque.shape[0]
    out = np.full((count, samples, mechanism.n), np.nan)
    alive = np.isfinite(beta).all(axis=1)
    where = np.flatnonzero(alive)
    q, qd = np.tile(q0, (where.size, 1)), np.tile(qd0, (where.size, 1))
    sign = np.asarray(np.sign(np.linalg.det(mechanism.inertia_matrix(q, beta[where]))))
    keep = np.asarray(sign != 0.0)
    for k in range(samples):
        where, q, qd, sign = where[keep], q[keep], qd[keep], sign[keep]
        out[where, k] = q
        if k + 1 == samples or where.size == 0:
            break
        with np.errstate(over="ignore", invalid="ignore"):
            q, qd = advance(mechanism, beta[where], q, qd, torque[k], dt_s, substeps)
            bounded = np.isfinite(qd) & np.isfinite(q) & (np.abs(qd) < RATE_LIMIT)
        fit = np.asarray(np.all(bounded, axis=1))
        safe = np.where(fit[:, None], q, 0.0)
        keep = fit & (np.sign(np.linalg.det(mechanism.inertia_matrix(safe, beta[where]))) == sign)
    failed = ~np.isfinite(out[:, -1]).all(axis=1)
    return FreeRuns(out, failed)
