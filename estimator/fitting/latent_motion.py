"""`converge_motion`: the most likely motion of a record with parameters and noise levels held.

Full Gauss-Newton steps alternate between two motions where a joint reverses close to a sample. So a step that raises
the objective is followed by a shorter one. (Measured with dry friction: full steps end 20 to 9,000 above the optimum.)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.errors import FitError
from estimator.fitting.gauss_newton import REST_STEPS, shortened
from estimator.likelihood import LatentProblem, State, find_stiction
from estimator.numerics import eliminate

SAME_OBJECTIVE = 0.1
"""Fall of the objective, -2 log likelihood, below which a step changes nothing: one predicted, or two observed, end the
search."""
CONVERGE_STEPS = 15
"""Most steps from the motion of a fit, whose noise levels still move and whose objective is compared."""
FREE_STEPS = 3
"""Steps that are not shortened: they come from far off."""
SHORTEST = 0.1
"""Least share of a step that is taken."""


def converge_motion(problem: LatentProblem, state: State, limit: int = CONVERGE_STEPS) -> State:
    """`state` with the likeliest motion, sought from its own in up to `limit` steps.

    Where neither the problem nor the state knows what dry friction leaves open at rest, it is found on the way. Raises
    `FitError` where the equations become singular.
    """
    x, best, lowest, noise = state.x, state.x, np.inf, state.noise
    converged_steps, share, before = 0, 1.0, np.inf
    seeks_rest = problem.stiction(noise) is None
    for iteration in range(limit + 1):
        updates_rest = seeks_rest and iteration < REST_STEPS
        if updates_rest:
            noise = replace(noise, stiction=find_stiction(problem, x.v, state.beta))
            lowest = before = np.inf  # that was by other weights
        point = problem.motion_equations(x, state.beta, noise)
        if point.objective < lowest:
            lowest, best = point.objective, x
        fall, before = before - point.objective, point.objective
        converged_steps = converged_steps + 1 if abs(fall) < SAME_OBJECTIVE else 0
        if converged_steps == 2 or iteration == limit:
            break
        if iteration >= FREE_STEPS:
            if fall < 0.0 and share == SHORTEST:  # effects whose slope the equations neglect: no step lowers it
                break
            share = max(SHORTEST, 0.5 * share) if fall < 0.0 else min(1.0, 1.2 * share)
        try:
            solved = eliminate(point.chain)
        except np.linalg.LinAlgError:
            raise FitError("the equations of the motion became singular") from None
        predicted_fall = float(solved.product()[0, 0])
        if predicted_fall < SAME_OBJECTIVE and not updates_rest:
            break
        step = -solved.solution(np.ones(1))
        x = x.moved(shortened(step[:, : problem.n], share) * step)
    return replace(state, x=best, noise=noise)
