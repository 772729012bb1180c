"""An independent leg with dry friction as a set-valued force: reversals and rest found to the microsecond.

Between events both joints keep a mode (slides forward, slides back, sticks) and the smooth equation of motion is
integrated by Runge-Kutta's fourth order; a speed that reaches zero, and a stuck joint whose friction no longer
suffices, end the step at their own instant, and the modes there are those that are consistent. The motor is driven at
ticks of 1 kHz, its torque held from one to the next: by a plan, or by a position controller. Nothing of the estimator's
motion model is in here.
"""

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from daq import Dataset
from tests.support.mujoco_leg import GRAVITY, Leg, multisine

TICK_S = 1e-3
STEPS = 8
"""Steps of integration a tick."""
STIFFNESS, DAMPING = 12.0, 0.5
"""Of the position controller [N m/rad, N m s/rad]."""
PEAK_NM = 2.0
ENCODER_COUNTS = 8192


@numba.njit(cache=True)
def _solve(q: Any, v: Any, u: float, s: Any, beta: Any, acc: Any, hold: Any) -> None:
    """Accelerations, and the torques that friction holds where a joint sticks (mode 0)."""
    d, b = np.empty((2, 2)), np.empty(2)
    c2, s2 = np.cos(q[1]), np.sin(q[1])
    d[0, 0] = beta[0] + beta[1] + 2 * beta[2] * c2
    d[0, 1] = d[1, 0] = beta[1] + beta[2] * c2
    d[1, 1] = beta[1]
    knee = beta[4] * GRAVITY * np.sin(q[0] + q[1])
    b[0] = -beta[2] * s2 * (2 * v[0] * v[1] + v[1] * v[1]) + beta[3] * GRAVITY * np.sin(q[0]) + knee
    b[1] = beta[2] * s2 * v[0] * v[0] + knee
    for j in range(2):
        b[j] = (u if j == 1 else 0.0) - b[j] - beta[5 + j] * v[j] - beta[7 + j] * s[j]
    hold[0] = hold[1] = 0.0
    if s[0] == 0.0 and s[1] == 0.0:
        acc[0] = acc[1] = 0.0
        hold[0], hold[1] = b[0], b[1]
    elif s[0] == 0.0:
        acc[0], acc[1] = 0.0, b[1] / d[1, 1]
        hold[0] = b[0] - d[0, 1] * acc[1]
    elif s[1] == 0.0:
        acc[0], acc[1] = b[0] / d[0, 0], 0.0
        hold[1] = b[1] - d[1, 0] * acc[0]
    else:
        det = d[0, 0] * d[1, 1] - d[0, 1] * d[1, 0]
        acc[0] = (d[1, 1] * b[0] - d[0, 1] * b[1]) / det
        acc[1] = (d[0, 0] * b[1] - d[1, 0] * b[0]) / det


@numba.njit(cache=True)
def _choose(q: Any, v: Any, u: float, s: Any, beta: Any) -> None:
    """Set the modes: by the speed where a joint moves, otherwise those consistent with what follows."""
    acc, hold, trial = np.empty(2), np.empty(2), np.empty(2)
    found = False
    for a in range(3):
        for b in range(3):
            if found:
                continue
            fits = True
            for j in range(2):
                want = (0.0, 1.0, -1.0)[a if j == 0 else b]
                if v[j] != 0.0 and want != np.sign(v[j]):
                    fits = False
                trial[j] = want
            if not fits:
                continue
            _solve(q, v, u, trial, beta, acc, hold)
            for j in range(2):
                if v[j] == 0.0 and ((trial[j] == 0.0 and abs(hold[j]) > beta[7 + j]) or trial[j] * acc[j] < 0.0):
                    fits = False
            if fits:
                s[0], s[1] = trial[0], trial[1]
                found = True


@numba.njit(cache=True)
def _advance(q: Any, v: Any, u: float, s: Any, beta: Any, h: float, q1: Any, v1: Any) -> None:
    """Runge-Kutta's fourth order from q, v to q1, v1."""
    k, r, hold = np.empty((4, 2)), np.empty((4, 2)), np.empty(2)
    for i in range(4):
        f = 0.0 if i == 0 else (h if i == 3 else 0.5 * h)
        for j in range(2):
            q1[j] = q[j] + (f * r[i - 1, j] if i else 0.0)
            v1[j] = v[j] + (f * k[i - 1, j] if i else 0.0)
        r[i] = v1
        _solve(q1, v1, u, s, beta, k[i], hold)
    for j in range(2):
        q1[j] = q[j] + h / 6 * (r[0, j] + 2 * r[1, j] + 2 * r[2, j] + r[3, j])
        v1[j] = v[j] + h / 6 * (k[0, j] + 2 * k[1, j] + 2 * k[2, j] + k[3, j])


@numba.njit(cache=True)
def _room(q: Any, v: Any, u: float, s: Any, beta: Any) -> float:
    """Least of what keeps the modes: speed along the sliding joints' modes, friction left to the stuck ones."""
    acc, hold = np.empty(2), np.empty(2)
    _solve(q, v, u, s, beta, acc, hold)
    least = np.inf
    for j in range(2):
        least = min(least, beta[7 + j] - abs(hold[j]) if s[j] == 0.0 else s[j] * v[j])
    return least


@numba.njit(cache=True)
def _tick(q: Any, v: Any, u: float, s: Any, beta: Any) -> None:
    """One tick under a constant torque, in place."""
    q1, v1, qa, va = np.empty(2), np.empty(2), np.empty(2), np.empty(2)
    _choose(q, v, u, s, beta)
    for _ in range(STEPS):
        left, tries = TICK_S / STEPS, 0
        while left > 1e-9 and tries < 20:
            tries += 1
            _advance(q, v, u, s, beta, left, q1, v1)
            if _room(q1, v1, u, s, beta) >= 0.0:
                q[:], v[:] = q1, v1
                left = 0.0
                continue
            low, high = 0.0, left
            for _ in range(30):
                middle = 0.5 * (low + high)
                _advance(q, v, u, s, beta, middle, qa, va)
                if _room(qa, va, u, s, beta) >= 0.0:
                    low = middle
                else:
                    high = middle
            _advance(q, v, u, s, beta, high, qa, va)
            for j in range(2):
                if s[j] != 0.0 and s[j] * va[j] <= 0.0:
                    va[j] = 0.0
            q[:], v[:] = qa, va
            left -= high
            _choose(q, v, u, s, beta)


@numba.njit(cache=True)
def _simulate(beta: Any, reference: Any, rate: Any, feed: Any, closed: bool, most: float, rows: Any) -> None:
    """rows (T, 7): q1, q2, v1, v2, qdd1, torque before and after each tick; accelerations are means of both sides."""
    q, v, s = np.zeros(2), np.zeros(2), np.zeros(2)
    acc, hold = np.empty(2), np.empty(2)
    u = 0.0
    for k in range(reference.size):
        _choose(q, v, u, s, beta)
        _solve(q, v, u, s, beta, acc, hold)
        before, old = acc[0], u
        u = feed[k]
        if closed:
            u += STIFFNESS * (reference[k] - q[1]) + DAMPING * (rate[k] - v[1])
        u = min(max(u, -most), most)
        _choose(q, v, u, s, beta)
        _solve(q, v, u, s, beta, acc, hold)
        rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3] = q[0], q[1], v[0], v[1]
        rows[k, 4], rows[k, 5], rows[k, 6] = 0.5 * (before + acc[0]), old, u
        _tick(q, v, u, s, beta)


@dataclass(frozen=True)
class Motion:
    """What happened, at every tick."""

    time: np.ndarray
    rows: np.ndarray
    """(T, 7) of `_simulate`."""
    leg: Leg


def move(leg: Leg, rng: np.random.Generator, *, seconds: float = 20.0, closed: bool = False, high: float = 3.0
         ) -> Motion:
    """A motion from rest: a multisine of torque [N m], or of the knee's angle [rad] under the position controller."""
    time = np.arange(round(seconds / TICK_S)) * TICK_S
    x = multisine(rng, time, 1.0 if closed else 1.6, high=high)
    fade = np.minimum(1.0, time / 0.5)
    x = x * fade * fade
    rows = np.empty((time.size, 7))
    feed = np.zeros_like(x) if closed else x
    _simulate(leg.beta(), x, np.gradient(x, TICK_S), feed, closed, PEAK_NM if closed else 10.0, rows)
    return Motion(time, rows, leg)


def drive(leg: Leg, torque: np.ndarray) -> Motion:
    """A motion from rest under a torque of every tick [N m]."""
    rows = np.empty((torque.size, 7))
    _simulate(leg.beta(), np.zeros_like(torque), np.zeros_like(torque), torque, False, 10.0, rows)
    return Motion(np.arange(torque.size) * TICK_S, rows, leg)


def sample(motion: Motion, rng: np.random.Generator, rate_hz: float, *, name: str = "run") -> Dataset:
    """What a recorder on a grid of `rate_hz` has of a motion; at a tick torque and acceleration are the mean of both
    sides, as a sensor that sees a short while sees them."""
    rows = motion.rows[:: round(1.0 / (rate_hz * TICK_S))]
    n = len(rows)
    q1, q2, w, _, a, u0, u1 = rows.T
    lever, grid = motion.leg.lever, 2 * np.pi / ENCODER_COUNTS
    columns = {
        "q1_rad": np.round(q1 / grid) * grid, "q2_rad": np.round(q2 / grid) * grid,
        "tau2_nm": 0.5 * (u0 + u1) + 0.02 * rng.normal(size=n), "gyro_radps": w + 0.005 * rng.normal(size=n),
        "accel_x_mps2": lever * a + GRAVITY * np.sin(q1) + 0.05 * rng.normal(size=n),
        "accel_y_mps2": -lever * w**2 - GRAVITY * np.cos(q1) + 0.05 * rng.normal(size=n)}
    return Dataset(name, rate_hz, np.arange(n) / rate_hz, {k: np.ascontiguousarray(x) for k, x in columns.items()})
