"""The paper's literal recipe, section IV: free latents, numerical gradient and Hessian of (50), Newton's step (51)."""

from collections.abc import Callable
from typing import Any

import numpy as np

from daq import FloatArray
from estimator.fitting.mle_free import FreeProblem, build_problem, first_latents
from estimator.signals import split_signals
from evidence.bench.record import OPTIONS, Recorded, Watch

STEP = 3e-3
"""Of the numerical derivatives, as a share of a latent's standard deviation."""
MAX_STEPS = 50
TOLERANCE = 1e-3
"""The search ends when a step moves no latent by more than this share of its standard deviation."""


def posed(recorded: Recorded) -> FreeProblem:
    return build_problem(split_signals([recorded.data], recorded.mechanism, OPTIONS), recorded.mechanism, OPTIONS)


def evaluations(latents: int) -> int:
    """Sums of squares that one of Newton's steps takes."""
    return 1 + 2 * latents + 2 * latents * (latents - 1)


def newton(problem: FreeProblem, w: FloatArray) -> tuple[FloatArray, int]:
    """Latents at the minimum, and steps."""
    def s(at: FloatArray) -> float:
        r = problem.residual(at)
        return float(r @ r)

    h = STEP * problem.sigma
    steps, moved = 0, np.inf
    while moved > TOLERANCE and steps < MAX_STEPS:
        steps += 1
        here = s(w)
        up, down = (np.array([_at(s, w, (i, k * h[i])) for i in range(w.size)]) for k in (1, -1))
        hessian = np.diag((up - 2 * here + down) / h**2)
        for i in range(w.size):
            for j in range(i):
                both = sum(a * b * _at(s, w, (i, a * h[i]), (j, b * h[j])) for a in (1, -1) for b in (1, -1))
                hessian[i, j] = hessian[j, i] = both / (4 * h[i] * h[j])
        step = np.linalg.solve(hessian, (up - down) / (2 * h))
        w, moved = w - step, float(np.max(np.abs(step) / problem.sigma))
    return w, steps


def _at(s: Callable[[FloatArray], float], w: FloatArray, *moves: tuple[int, float]) -> float:
    for i, by in moves:
        w[i] += by
    value = s(w)
    for i, by in moves:
        w[i] -= by
    return value


def solve(recorded: Recorded, announce: Callable[[dict[str, Any]], None], limit_s: float) -> dict[str, Any]:
    """Fit; tells first how long one step will take, and does not begin where that is beyond the limit."""
    problem = posed(recorded)
    w = first_latents(problem)
    problem.residual(w)
    watch = Watch()
    for _ in range(20):
        problem.residual(w)
    once = watch.seconds() / 20
    step_s = once * evaluations(w.size)
    announce({"evaluation_s": once, "evaluations": evaluations(w.size), "step_s": step_s})
    if step_s > limit_s:
        return {"failed": f"a step takes more than {limit_s:.0f} s"}
    watch = Watch()
    w, steps = newton(problem, w.copy())
    return {"seconds": watch.seconds(), "iterations": steps, "beta": problem.best_beta(problem.regressor(w)).tolist()}
