"""Free-run simulation: forward dynamics driven by sampled torque, vectorised over leading axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.mechanism import Mechanism

FloatArray = NDArray[np.float64]
HOLDS = ("zero", "linear", "average")


def substeps_for(mechanism: Mechanism, beta: FloatArray, dt_s: float) -> int:
    """Steps a sample that keep fourth-order Runge-Kutta stable on the rounded Coulomb sign (rate F/(eps I)).

    Stability needs rate * step < 2.7; half of that is used for accuracy. At least 2, at most 50.
    """
    friction = [b for b, a in zip(np.abs(beta), mechanism.parameters) if a.term == "coulomb"]
    if not friction:
        return 2
    probe = np.zeros((16, mechanism.n))
    probe[:, 1:] = np.linspace(-np.pi, np.pi, 16)[:, None]
    inverse = np.linalg.inv(mechanism.inertia_matrix(probe, beta))
    softest = float(np.max(np.abs(np.linalg.eigvalsh(0.5 * (inverse + np.swapaxes(inverse, -1, -2))))))
    rate = max(friction) * softest / mechanism.velocity_scale
    return int(np.clip(np.ceil(rate * dt_s / 1.3), 2, 50))


def torque_between(tau: FloatArray, k: int, hold: str, fraction: float) -> FloatArray:
    """Torque (..., n) at `fraction` of the step from sample k to k+1; tau (..., N, n).

    zero: sample k until the next. linear: a ramp. average: each sample is the mean of a window centred
    on its stamp, so it acts until half-way.
    """
    if hold == "zero":
        return tau[..., k, :]
    if hold == "average":
        return tau[..., k if fraction < 0.5 else k + 1, :]
    return (1.0 - fraction) * tau[..., k, :] + fraction * tau[..., k + 1, :]


def simulate(mechanism: Mechanism, beta: FloatArray, q0: FloatArray, qd0: FloatArray, tau: FloatArray, dt_s: float,
             hold: str = "linear", substeps: int | None = None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(q, qd, qdd), each (..., N, n), from the state q0, qd0 (..., n) under torque samples tau (..., N, n).

    Classical Runge-Kutta with `substeps` steps a sample (default: `substeps_for`; even for the average
    hold, so that its switch falls on a step). A motion that leaves the range of floats is NaN from there on.
    """
    if hold not in HOLDS:
        raise ValueError(f"hold {hold!r} is none of {HOLDS}")
    m = substeps if substeps is not None else substeps_for(mechanism, beta, dt_s)
    m += m % 2 if hold == "average" else 0
    h = dt_s / m
    lead = np.broadcast_shapes(q0.shape[:-1], tau.shape[:-2], beta.shape[:-1])
    samples = tau.shape[-2]
    q = np.empty((*lead, samples, mechanism.n))
    qd = np.empty_like(q)
    qdd = np.empty_like(q)
    x, v = np.broadcast_to(q0, (*lead, mechanism.n)), np.broadcast_to(qd0, (*lead, mechanism.n))

    def acceleration(position: FloatArray, velocity: FloatArray, torque: FloatArray) -> FloatArray:
        return mechanism.forward_dynamics(position, velocity, torque, beta)

    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(samples):
            q[..., k, :], qd[..., k, :] = x, v
            qdd[..., k, :] = acceleration(x, v, tau[..., k, :])
            if k == samples - 1:
                break
            for i in range(m):
                u1 = torque_between(tau, k, hold, i / m)
                u2 = torque_between(tau, k, hold, (i + 0.5) / m)
                u3 = torque_between(tau, k, hold, (i + 1) / m - 1e-12)
                a1 = acceleration(x, v, u1)
                v2 = v + 0.5 * h * a1
                a2 = acceleration(x + 0.5 * h * v, v2, u2)
                v3 = v + 0.5 * h * a2
                a3 = acceleration(x + 0.5 * h * v2, v3, u2)
                v4 = v + h * a3
                a4 = acceleration(x + h * v3, v4, u3)
                x = x + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
                v = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
                lost = ~np.isfinite(v).all(axis=-1, keepdims=True) | (np.abs(v) > 1e6).any(axis=-1, keepdims=True)
                x, v = np.where(lost, np.nan, x), np.where(lost, np.nan, v)
    return q, qd, qdd
