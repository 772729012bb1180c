"""`score_runs`: what each run of a fit says of the parameters by itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from daq import FloatArray
from estimator.likelihood import LatentProblem, Latents, State
from estimator.numerics import eliminate
from estimator.signals import SignalSet

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
    for run, stretches, where in _by_run(signals):
        problem = problem_of(stretches)
        if fitted.stiction_variance is not None:
            problem.stiction_variance = fitted.stiction_variance[where]
        problem.predicted_misfit = np.full(problem.n, np.inf)  # a run's misfit counts as it is
        x = Latents(state.x.q[where], state.x.v[where], state.x.u[where])
        point = problem.linearise(x, beta, state.noise)
        product = eliminate(point.chain).product()
        found.append((run, product[1:, 0] - point.gradient_beta, point.corner - product[1:, 1:]))
    runs, score, information = zip(*found, strict=True)
    return RunScores(runs, np.array(score), np.array(information))


def _by_run(signals: Sequence[SignalSet]) -> list[tuple[str, list[SignalSet], slice]]:
    """Name, stretches and samples of each run; stretches of a run follow each other, in time too."""
    found: list[tuple[str, list[SignalSet], slice]] = []
    start = 0
    for s in signals:
        end = start + len(s.time_s)
        if found and found[-1][0] == s.run and found[-1][1][-1].time_s[-1] < s.time_s[0]:
            _, stretches, where = found.pop()
            found.append((s.run, [*stretches, s], slice(where.start, end)))
        else:
            found.append((s.run, [s], slice(start, end)))
        start = end
    return found
