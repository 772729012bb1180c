"""`score_runs`: what each run of a fit says of the parameters by itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from daq import FloatArray
from estimator.likelihood import LatentProblem, Latents, State
from estimator.numerics import eliminate
from estimator.signals import SignalSet, by_run

Problem = Callable[[list[SignalSet]], LatentProblem]


class RunScores(NamedTuple):
    """Score and information of R runs at one point, the motion eliminated."""

    runs: tuple[str, ...]
    """Their names."""
    score: FloatArray
    """(R, m) derivative of each run's log-likelihood by the parameters"""
    information: FloatArray
    """(R, m, m)"""


def score_runs(signals: Sequence[SignalSet], problem_of: Problem, fitted: LatentProblem, state: State,
               beta: FloatArray) -> RunScores:
    """Each run of `signals` scored at the motion and the noise levels of `state`, and at beta (m,).

    `problem_of` makes a run's problem of its stretches, as `fitted` was made of all. Latents of runs are not coupled,
    so the scores add up to that of the fit. Costs a Gauss-Newton step.
    """
    found = []
    for run, stretches, where in by_run(signals):
        problem = problem_of(stretches)
        if fitted.stiction_variance is not None:
            problem.stiction_variance = fitted.stiction_variance[where]
        problem.loud = fitted.loud and fitted.loud.of(where)
        problem.predicted_misfit = np.full(problem.n, np.inf)  # a run's misfit counts as it is
        x = Latents(state.x.q[where], state.x.v[where], state.x.u[where])
        point = problem.linearise(x, beta, state.noise)
        product = eliminate(point.chain).product()
        found.append((run, product[1:, 0] - point.gradient_beta, point.corner - product[1:, 1:]))
    runs, score, information = zip(*found, strict=True)
    return RunScores(runs, np.array(score), np.array(information))
