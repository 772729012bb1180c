"""`score_runs`: score and information of each run of a fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from daq import FloatArray
from estimator.fitting.warm_start import LEAST_SEGMENT, cut
from estimator.likelihood import LatentProblem, Latents, Noise, State
from estimator.numerics import eliminate
from estimator.signals import SignalSet, by_run

MOST_SEGMENTS, FEWEST_SEGMENTS = 24, 8
"""Segments of a single run that vote like runs: fewer cannot tell their scatter."""
SEGMENT_S, TIME_CONSTANTS = 0.5, 4.0
"""Length of a segment at least [s], and in time constants of a disturbance: what errs alike within it counts once."""
Problem = Callable[[list[SignalSet]], LatentProblem]


class RunScores(NamedTuple):
    """Score and information of R runs at one point, the motion eliminated."""

    runs: tuple[str, ...]
    """Their names; of segments their times."""
    score: FloatArray
    """(R, m) derivative of each run's log-likelihood by the parameters"""
    information: FloatArray
    """(R, m, m)"""
    unit: Literal["run", "segment"] = "run"
    """What is scored: runs, or segments of one run."""


def score_runs(signals: Sequence[SignalSet], problem_of: Problem, fitted: LatentProblem, state: State,
               beta: FloatArray) -> RunScores:
    """Score and information of each run of `signals` at `state` and beta (m,); of a single run of each of its parts.

    `problem_of` returns the problem of some gap-free segments, as `fitted` is that of all. The scores of runs add up to
    that of the fit; parts lose the equation of motion between them. Costs one Gauss-Newton step.
    """
    found = []
    parts = by_run(signals)
    for run, own, where in parts if len(parts) > 1 else segments(signals, fitted, state):
        found.append((run, *score_at(problem_of(own), state.x.of(where), beta, state.noise.at(where))))
    if not found:
        return RunScores((parts[0][0],), np.zeros((1, beta.size)), np.zeros((1, beta.size, beta.size)))
    runs, score, information = zip(*found, strict=True)
    return RunScores(runs, np.array(score), np.array(information), "run" if len(parts) > 1 else "segment")


def score_at(problem: LatentProblem, x: Latents, beta: FloatArray, noise: Noise) -> tuple[FloatArray, FloatArray]:
    """Score (m,) and information (m, m) of a problem at one point, the motion eliminated."""
    as_it_is = np.full(problem.n, np.inf)  # no bound on a run's misfit
    point = problem.linearise(x, beta, noise, predicted_misfit=as_it_is)
    product = eliminate(point.chain).product()
    return product[1:, 0] - point.gradient_beta, point.corner - product[1:, 1:]


def segments(signals: Sequence[SignalSet], fitted: LatentProblem, state: State
             ) -> list[tuple[str, list[SignalSet], slice]]:
    """Name, signals and samples of each of up to MOST_SEGMENTS segments of a single run; empty where it is too short.

    A segment is longer than the torque's disturbance is correlated, and than SEGMENT_S.
    """
    constants = state.noise.time_constant[state.noise.disturbance > 0.0]
    least_s = max(SEGMENT_S, TIME_CONSTANTS * float(np.max(constants, initial=0.0)))
    least = max(LEAST_SEGMENT, round(least_s / fitted.dt), fitted.total // MOST_SEGMENTS)
    found = []
    for s, end in zip(signals, fitted.ends):
        count = len(s.time_s)
        edges = np.linspace(0, count, max(1, count // least) + 1).astype(int)
        for a, b in pairwise(edges):
            name = f"{s.time_s[a] - signals[0].time_s[0]:.3g} to {s.time_s[b - 1] - signals[0].time_s[0]:.3g} s"
            begin = int(end) - count
            found.append((name, [cut(s, slice(int(a), int(b)))], slice(begin + int(a), begin + int(b))))
    return found if len(found) >= FEWEST_SEGMENTS else []
