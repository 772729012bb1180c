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

from daq import BoolArray, FloatArray, IndexArray
from estimator.model.collocation import GAUSS, Collocation
from estimator.model.mechanism import Mechanism
from estimator.model.terms import Motion
from estimator.numerics import solve_bidiagonal

_Terms = tuple[Motion, FloatArray]
"""Motion, and the derivatives of the torque that it needs by its features (n, 2, 5, n, K)"""
_Path = tuple[FloatArray, FloatArray, FloatArray]
"""Angles and rates (K + 1, n), states of the law (K + 1, S)"""
WINDOW = 20
"""Samples a window when marching."""
MAX_NEWTON = 40


class Law(Protocol):
    """Torque that something outside the mechanism takes by the motion and by S states of its own."""

    @property
    def states(self) -> FloatArray:
        """(N, S) guess of its states; the first of a simulation holds."""

    def torque(self, motion: Motion, where: slice, z: FloatArray) -> FloatArray:
        """(n, 2, K) on the intervals `where` of the simulation, with the states z (K + 1, S) at their ends."""

    def slopes(self, motion: Motion, where: slice, z: FloatArray) -> FloatArray:
        """(n, 5, n, 2, K) its derivatives by the features of the motion."""

    def by_states(self, motion: Motion, where: slice, z: FloatArray) -> FloatArray:
        """(n, 2, S, K) its derivatives by the states at the Gauss points."""

    def gaps(self, v: FloatArray, z: FloatArray) -> FloatArray:
        """(S, K) what the states miss of their own equation along the rates v (K + 1, n)."""

    def gap_slopes(self, v: FloatArray, z: FloatArray) -> FloatArray:
        """(S, 2, n + S, K) its derivatives by the rates and states at both ends of each interval."""


def simulate(mechanism: Mechanism, beta: FloatArray, q0: FloatArray, qd0: FloatArray, tau: FloatArray, dt_s: float,
             hold: str = "linear", guess: tuple[FloatArray, FloatArray] | None = None,
             taken: FloatArray | None = None, law: Law | None = None,
             restarts: IndexArray | None = None) -> tuple[FloatArray, FloatArray, FloatArray]:
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
        near_q, near_v = guess[0].copy(), guess[1].copy()
        near_q[0], near_v[0] = q0, qd0
        found = _newton(equation, slice(0, n - 1), (near_q, near_v, equation.states(n)))
        if found is not None:
            q, v = found[:2]
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
    held: BoolArray | None = None
    """(K,) intervals whose later end is given: no equation, but that it stays."""

    def torque(self, where: slice) -> FloatArray:
        """(n, 2, K) on the intervals `where`, without what the law takes."""
        torque = self.collocation.torque(self.tau, where)
        if self.between is not None:
            torque = torque + self.between[:, :, where]
        return torque if self.taken is None else torque - self.taken[:, :, where]

    def states(self, count: int) -> FloatArray:
        """(count, S) states of the law near the simulated motion."""
        return np.zeros((count, 0)) if self.law is None else self.law.states[:count]

    @cached_property
    def between(self) -> FloatArray | None:
        return self.collocation.between(self.tau, np.array([len(self.tau)]))

    def defect(self, where: slice, path: _Path, torque: FloatArray) -> tuple[FloatArray, _Terms]:
        """(2 n + S, K) what is left of the equations of motion and of the states along a path."""
        c, (q, v, states) = self.collocation, path
        motion = c.motion(q, v, slice(0, len(q) - 1))
        z, slopes = c.fast(*motion, self.beta)
        left = (self.beta @ z.reshape(len(self.beta), -1)).reshape(torque.shape) - torque
        if self.law is not None:
            left = left + self.law.torque(motion, where, states)
        rows = left.reshape(2 * len(left), -1)
        if states.shape[1] and self.law is not None:
            rows = np.concatenate([rows, self.law.gaps(v, states)])
        if self.held is not None:
            rows[:, self.held[where]] = 0.0
        return rows, (motion, slopes)

    def jacobian(self, where: slice, terms: _Terms, path: _Path) -> FloatArray:
        """(b, 2, b, K) its derivatives by angles, rates and states at both ends of each interval; b = 2 n + S."""
        (motion, slopes), (_, v, states) = terms, path
        added = None if self.law is None else self.law.slopes(motion, where, states)
        found = self.collocation.by_ends(slopes, added)
        n, count = len(found), states.shape[1]
        out = found.reshape(2 * n, 2, 2 * n, -1)
        if count and self.law is not None:
            out = np.pad(out, [(0, count), (0, 0), (0, count), (0, 0)])
            felt = self.law.by_states(motion, where, states)
            for end in range(2):
                share = np.array([g if end else 1.0 - g for g in GAUSS])[:, None, None]
                out[: 2 * n, end, 2 * n :] = (share * felt).reshape(2 * n, count, -1)
            out[2 * n :, :, n:] = self.law.gap_slopes(v, states)
        if self.held is not None:  # of the later end nothing moves
            given = np.flatnonzero(self.held[where])
            out[..., given] = 0.0
            for row in range(len(out)):
                out[row, 1, row, given] = 1.0
        return out


def _march(equation: _Equation, q: FloatArray, v: FloatArray) -> None:
    """Fill q, v (N, n) from their first sample on, window by window; stops where no solution is found."""
    n, window, start = len(q), WINDOW, 0
    states = equation.states(n)[0]
    m, dt = equation.collocation.mechanism, equation.collocation.dt
    while start < n - 1:
        stop = min(start + window, n - 1)
        k = np.arange(stop - start + 1)[:, None]
        with np.errstate(all="ignore"):
            try:
                a = m.forward_dynamics(q[start], v[start], equation.tau[start], equation.beta) if window == 1 else 0.0
            except np.linalg.LinAlgError:  # a fit that did not converge can have no inertia at all
                return
        gq, gv = q[start] + v[start] * dt * k + 0.5 * a * (dt * k) ** 2, v[start] + a * dt * k
        found = _newton(equation, slice(start, stop), (gq, gv, np.tile(states, (len(k), 1))))
        if found is None:
            if window == 1:
                return
            window = max(1, window // 4)
            continue
        q[start : stop + 1], v[start : stop + 1], states = found[0], found[1], found[2][-1]
        start, window = stop, min(WINDOW, 2 * window)


def _newton(equation: _Equation, where: slice, path: _Path) -> _Path | None:
    """Solve the collocation equations with the first sample held; None where Newton does not converge."""
    edges, torque = np.cumsum([x.shape[1] for x in path])[:-1], equation.torque(where)
    scale = 1e-9 * (1.0 + float(np.max(np.abs(torque))))
    with np.errstate(all="ignore"):
        defect, terms = equation.defect(where, path, torque)
        size = float(np.max(np.abs(defect)))
        for _ in range(MAX_NEWTON):
            if not np.isfinite(size):
                return None
            try:
                step = np.split(solve_bidiagonal(equation.jacobian(where, terms, path), -defect), edges, axis=1)
            except np.linalg.LinAlgError:
                return None
            share = 1.0
            for _ in range(6):
                tried = [x.copy() for x in path]
                for x, moved in zip(tried, step):
                    x[1:] += share * moved
                trial, trial_terms = equation.defect(where, (tried[0], tried[1], tried[2]), torque)
                norm = float(np.linalg.norm(trial))
                if np.isfinite(norm) and norm < (1.0 - 0.1 * share) * float(np.linalg.norm(defect)):
                    break
                share *= 0.5
            path, defect, terms = (tried[0], tried[1], tried[2]), trial, trial_terms
            size = float(np.max(np.abs(defect)))
            if size < scale or (size < 1e4 * scale and share < 1.0):
                return path
    return None
