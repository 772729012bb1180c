"""Free-run simulation of a model with effects, and what its sensors would read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

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
LOOSE_RAD = 0.02
"""What may still move after PASSES."""
HOPELESS = 12
"""Passes after which plain iteration that still moves that much gives way to mixing of ..."""
DEPTH = 12
"""... so many steps."""
WINDOW_S = 0.5
WINDOW_PASSES = 25
"""Of `_marched`: longer windows need more passes, shorter ones are more of them. (Measured on a ripple of 100 periods a
rad over 20 s: 721 evaluations in windows of 0.25 s, 558 of 0.5 s.)"""


@dataclass(frozen=True)
class FreeRun:
    """Motion from each stretch's first state and the torque alone."""

    q: FloatArray
    """(N, n)"""
    v: FloatArray
    readings: Mapping[str, FloatArray]
    """Channel to (N,), noise free."""


def free_run(problem: ExtendedProblem, state: State, torque: FloatArray | None = None,
             horizon_s: float = np.inf) -> FreeRun | None:
    """Simulate every stretch, or each piece of it of `horizon_s`, from its first state; None where it diverges.

    `torque` (N, n) drives it, by default the true torque in `state`. What effects add to the equation of
    motion is found by repeated simulation, each with the effects' torque of the one before.
    """
    m = problem.mechanism
    beta, sizes = problem.simulated(state.beta)
    u = problem.motor_torque(state.x, state.beta) if torque is None else torque
    parts = pieces(problem, horizon_s)
    found = _relaxed(problem, state, u, 0, parts)
    if found is None and problem.effects:
        found = _marched(problem, state, u, parts) or _relaxed(problem, state, u, DEPTH, parts)
    if found is None:
        return None
    q, v, added = found
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


def pieces(problem: ExtendedProblem, horizon_s: float) -> list[slice]:
    """Stretches cut into pieces of about `horizon_s`, of two samples at least."""
    out = []
    for begin, end in zip([0, *problem.ends[:-1]], problem.ends):
        most = max(1, (end - begin) // 2)
        wanted = (end - begin) * problem.collocation.dt / horizon_s
        count = min(most, max(1, round(wanted)))
        edges = np.linspace(begin, end, count + 1).astype(int)
        out += [slice(int(a), int(b)) for a, b in pairwise(edges)]
    return out


def _relaxed(problem: ExtendedProblem, state: State, u: FloatArray, depth: int,
             parts: Sequence[slice]) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """q, v (N, n) and what the effects take at the samples (n, N), by fixed-point iteration; None where it diverges.

    With `depth` steps mixed by Anderson's method, which settles where an effect feels itself with a gain above one
    (a base near its resonance); laws with a sign are better off without.
    """
    m, c = problem.mechanism, problem.collocation
    beta, sizes = problem.simulated(state.beta)
    q, v = state.x.q.copy(), state.x.v.copy()
    edge = m.n * 2 * problem.left.size
    taken = np.zeros(edge + m.n * problem.total)
    mixer, share, before = Anderson(depth), 1.0, np.inf
    for k in range(PASSES):
        gauss, samples = taken[:edge].reshape(m.n, 2, -1), taken[edge:].reshape(m.n, -1)
        if problem.effects:
            with np.errstate(all="ignore"):
                new_gauss, new, _ = problem.added(problem.view(Latents(q, v, u), beta, samples), sizes)
            wanted = np.concatenate([new_gauss.ravel(), new.ravel()])
            if not np.isfinite(wanted).all():
                return None
            taken = mixer.next(taken, wanted) if depth else taken + share * (wanted - taken)
            gauss, samples = taken[:edge].reshape(m.n, 2, -1), taken[edge:].reshape(m.n, -1)
        next_q, next_v = np.empty_like(q), np.empty_like(v)
        for where in parts:
            here = np.flatnonzero((problem.left >= where.start) & (problem.left < where.stop - 1))
            next_q[where], next_v[where], _ = simulate(
                m, beta, state.x.q[where.start], state.x.v[where.start], u[where], c.dt, c.hold,
                guess=(q[where], v[where]), taken=gauss[:, :, here])
        if not np.isfinite(next_q).all():
            return None
        moved = float(np.max(np.abs(next_q - q)))
        q, v = next_q, next_v
        if not problem.effects or moved < SETTLED_RAD:
            return q, v, samples
        if not depth and k >= HOPELESS and moved > LOOSE_RAD:
            return None
        if moved > 0.9 * before:
            share = max(0.2, 0.7 * share)
        before = moved
    return (q, v, samples) if moved <= LOOSE_RAD else None


def _marched(problem: ExtendedProblem, state: State, u: FloatArray,
             parts: Sequence[slice]) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """As `_relaxed`, one short window after the other: effects are causal.

    A law that grows with the angle (a ripple) feeds back over a whole record more than over a window, and one that
    grows with the acceleration (friction under load) over a window more than over a step. So a window in which steps do
    not settle is halved.
    """
    q, v = state.x.q.copy(), state.x.v.copy()
    samples = np.zeros((problem.mechanism.n, problem.total))
    longest = max(2, round(WINDOW_S / problem.collocation.dt))
    for part in parts:
        start, step = part.start, longest
        while start < part.stop - 1:
            window = slice(start, min(start + step, part.stop - 1) + 1)
            found = _window(problem, state, u, window, (q, v, samples))
            if found is not None:
                q, v, samples = found
                start, step = window.stop - 1, min(2 * step, longest)
            elif step > 1:
                step //= 2
            else:
                return None
    return q, v, samples


def _window(problem: ExtendedProblem, state: State, u: FloatArray, where: slice,
            before: tuple[FloatArray, FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """`before` with the motion in `where` simulated from its first sample; None where that does not settle."""
    m, c = problem.mechanism, problem.collocation
    beta, sizes = problem.simulated(state.beta)
    q, v, samples = (x.copy() for x in before)
    here = np.flatnonzero((problem.left >= where.start) & (problem.left < where.stop - 1))
    taken, share, last = np.zeros((m.n, 2, here.size)), 1.0, np.inf
    for _ in range(WINDOW_PASSES):
        with np.errstate(all="ignore"):
            gauss, new, _ = problem.added(problem.view(Latents(q, v, u), beta, samples), sizes)
        taken += share * (gauss[:, :, here] - taken)
        samples[:, where] += share * (new.reshape(m.n, -1)[:, where] - samples[:, where])
        if not (np.isfinite(taken).all() and np.isfinite(samples[:, where]).all()):
            return None
        next_q, next_v, _ = simulate(m, beta, q[where.start], v[where.start], u[where], c.dt, c.hold,
                                     guess=(q[where], v[where]), taken=taken)
        if not np.isfinite(next_q).all():
            return None
        moved = float(np.max(np.abs(next_q - q[where])))
        q[where], v[where] = next_q, next_v
        if moved < SETTLED_RAD:
            break
        if moved > 0.9 * last:
            share = max(0.2, 0.7 * share)
        last = moved
    return (q, v, samples) if moved <= LOOSE_RAD else None


class Anderson:
    """Anderson's mixing for x = g(x): the next x from the last `depth` steps (Walker and Ni 2011, type II)."""

    def __init__(self, depth: int) -> None:
        self.depth = depth
        self.points: list[FloatArray] = []
        self.errors: list[FloatArray] = []

    def next(self, x: FloatArray, wanted: FloatArray) -> FloatArray:
        """x to evaluate next, after g(x) came out as `wanted`."""
        self.points, self.errors = [*self.points, x][-self.depth:], [*self.errors, wanted - x][-self.depth:]
        steps, errors = np.diff(self.points, axis=0), np.diff(self.errors, axis=0)
        if not len(steps):
            return wanted
        weights = np.linalg.lstsq(errors.T, self.errors[-1], rcond=1e-8)[0]
        return np.asarray(wanted - weights @ (steps + errors))
