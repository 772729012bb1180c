"""Free-run simulation: the whole motion at once from the first state and the sampled torque.

The equation of motion is collocated as in `estimator.model.collocation`, so a simulation and a fit mean the same by
"the torque acts between samples". Newton's method on all samples together costs a few forward substitutions,
linear in samples, and is implicit: the stiff smoothed Coulomb sign needs no small step. Without a guess near the
solution the motion is marched in windows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.model.collocation import Collocation
from estimator.model.mechanism import Mechanism
from estimator.model.terms import Motion
from estimator.numerics import solve_bidiagonal

_Terms = tuple[Motion, FloatArray]
"""Motion, and the derivatives of the torque that it needs by its features (n, 2, 5, n, K)"""
WINDOW = 20
"""Samples a window when marching."""
MAX_NEWTON = 40


class Law(Protocol):
    """Torque that something outside the mechanism takes by the motion at the same instant."""

    def torque(self, motion: Motion, where: slice) -> FloatArray:
        """(n, 2, K) on the intervals `where` of the simulation."""

    def slopes(self, motion: Motion, where: slice) -> FloatArray:
        """(n, 5, n, 2, K) its derivatives by the features of the motion."""


def simulate(mechanism: Mechanism, beta: FloatArray, q0: FloatArray, qd0: FloatArray, tau: FloatArray, dt_s: float,
             hold: str = "linear", guess: tuple[FloatArray, FloatArray] | None = None,
             taken: FloatArray | None = None, law: Law | None = None,
             restarts: NDArray[np.intp] | None = None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(q, qd, qdd), each (N, n), from the state q0, qd0 (n,) under torque samples tau (N, n).

    - `guess`: a motion (q, qd) near the solution, such as the measured one.
    - `taken` (n, 2, N - 1): torque of effects at the Gauss points; `law`: their dependence on the motion.
    - `restarts`: samples at which the motion begins anew from the guess. If these do not converge together, all is NaN.

    NaN from the sample on where no solution is found.
    """
    n, beta = tau.shape[0], np.ascontiguousarray(beta, dtype=np.float64)
    held = None if restarts is None else np.isin(np.arange(1, n), restarts)
    equation = _Equation(Collocation(mechanism, dt_s, hold), beta, tau, taken, law, held)
    q, v = np.full((n, mechanism.n), np.nan), np.full((n, mechanism.n), np.nan)
    q[0], v[0] = q0, qd0
    if guess is not None and n > 1:
        found = _newton(equation, slice(0, n - 1), *_pinned(guess, q0, qd0))
        if found is not None:
            q, v = found
            if restarts is not None:  # to the last bit
                q[restarts], v[restarts] = guess[0][restarts], guess[1][restarts]
    if held is None and not np.isfinite(q).all():
        _march(equation, q, v)
    with np.errstate(invalid="ignore"):
        good = np.isfinite(q).all(axis=1)
        qdd = np.full_like(q, np.nan)
        qdd[good] = equation.collocation.fast.forward_dynamics(q[good], v[good], tau[good], beta)[0].T
    return q, v, qdd


@dataclass(frozen=True)
class _Equation:
    """The equation of motion on all intervals of a simulation."""

    collocation: Collocation
    beta: FloatArray
    tau: FloatArray
    taken: FloatArray | None
    law: Law | None
    held: NDArray[np.bool_] | None = None
    """(K,) intervals whose later end is given: no equation, but that it stays."""

    def torque(self, where: slice) -> FloatArray:
        """(n, 2, K) on the intervals `where`, without what the law takes."""
        torque = self.collocation.torque(self.tau, np.arange(where.start, where.stop))
        if self.between is not None:
            torque = torque + self.between[:, :, where]
        return torque if self.taken is None else torque - self.taken[:, :, where]

    @cached_property
    def between(self) -> FloatArray | None:
        return self.collocation.between(self.tau, np.array([len(self.tau)]))

    def defect(self, where: slice, q: FloatArray, v: FloatArray, torque: FloatArray) -> tuple[FloatArray, _Terms]:
        """(n, 2, K) what is left of the equation at q, v (K + 1, n)."""
        c = self.collocation
        motion = c.motion(q, v, np.arange(len(q) - 1))
        z, slopes = c.fast(*motion, self.beta)
        left = (self.beta @ z.reshape(len(self.beta), -1)).reshape(torque.shape) - torque
        if self.law is not None:
            left = left + self.law.torque(motion, where)
        if self.held is not None:
            left[:, :, self.held[where]] = 0.0
        return left, (motion, slopes)

    def jacobian(self, where: slice, terms: _Terms) -> FloatArray:
        """(n, 2, 4, n, K) its derivatives by both ends of each interval."""
        motion, slopes = terms
        added = None if self.law is None else self.law.slopes(motion, where)
        found = self.collocation.by_ends(slopes, added)
        if self.held is not None:
            given = np.flatnonzero(self.held[where])
            found[..., given] = 0.0
            for j, point in np.ndindex(found.shape[:2]):  # a row for the angle, one for the rate of the later end
                found[j, point, 2 + point, j, given] = 1.0
        return found


def _pinned(guess: tuple[FloatArray, FloatArray], q0: FloatArray, qd0: FloatArray) -> tuple[FloatArray, FloatArray]:
    q, v = guess[0].copy(), guess[1].copy()
    q[0], v[0] = q0, qd0
    return q, v


def _march(equation: _Equation, q: FloatArray, v: FloatArray) -> None:
    """Fill q, v (N, n) from their first sample on, window by window; stops where no solution is found."""
    n, window, start = len(q), WINDOW, 0
    m, dt = equation.collocation.mechanism, equation.collocation.dt
    while start < n - 1:
        stop = min(start + window, n - 1)
        k = np.arange(stop - start + 1)[:, None]
        with np.errstate(all="ignore"):
            a = m.forward_dynamics(q[start], v[start], equation.tau[start], equation.beta) if window == 1 else 0.0
        gq, gv = q[start] + v[start] * dt * k + 0.5 * a * (dt * k) ** 2, v[start] + a * dt * k
        found = _newton(equation, slice(start, stop), gq, gv)
        if found is None:
            if window == 1:
                return
            window = max(1, window // 4)
            continue
        q[start : stop + 1], v[start : stop + 1] = found
        start, window = stop, min(WINDOW, 2 * window)


def _newton(equation: _Equation, where: slice, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Solve the collocation equations with the first sample held; None where Newton does not converge."""
    n, b, torque = q.shape[1], 2 * q.shape[1], equation.torque(where)
    scale = 1e-9 * (1.0 + float(np.max(np.abs(torque))))
    with np.errstate(all="ignore"):
        defect, terms = equation.defect(where, q, v, torque)
        size = float(np.max(np.abs(defect)))
        for _ in range(MAX_NEWTON):
            if not np.isfinite(size):
                return None
            try:
                slopes = equation.jacobian(where, terms).reshape(b, 2, b, -1)
                step = solve_bidiagonal(slopes, -defect.reshape(b, -1))
            except np.linalg.LinAlgError:
                return None
            share = 1.0
            for _ in range(6):
                trial_q, trial_v = q.copy(), v.copy()
                trial_q[1:] += share * step[:, :n]
                trial_v[1:] += share * step[:, n:]
                trial, trial_terms = equation.defect(where, trial_q, trial_v, torque)
                norm = float(np.linalg.norm(trial))
                if np.isfinite(norm) and norm < (1.0 - 0.1 * share) * float(np.linalg.norm(defect)):
                    break
                share *= 0.5
            q, v, defect, terms = trial_q, trial_v, trial, trial_terms
            size = float(np.max(np.abs(defect)))
            if size < scale or (size < 1e4 * scale and share < 1.0):
                return q, v
    return None
