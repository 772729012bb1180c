"""`score_runs`: score and information of each run of a fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from daq import IndexArray
from estimator.likelihood import LatentProblem, State
from estimator.score.score import Score, score_at
from estimator.signals import LEAST_SEGMENT, SignalSet, by_run, cut

MOST_SEGMENTS, FEWEST_SEGMENTS = 24, 8
"""Segments of a single run that vote like runs: fewer cannot tell their scatter."""
SEGMENT_S, TIME_CONSTANTS = 0.5, 4.0
"""Length of a segment at least [s], and in time constants of a disturbance: what errs alike within it counts once."""
Problem = Callable[[list[SignalSet]], LatentProblem]


class RunScores(NamedTuple):
    """Scores of R runs at one point, or of the segments of a single one."""

    runs: tuple[str, ...]
    """Their names; of segments their times."""
    scores: tuple[Score, ...]
    """(R,); none of a single run that is too short"""
    unit: Literal["run", "segment"] = "run"
    """What is scored: runs, or segments of one run."""
    places: tuple[slice, ...] = ()
    """(R,) their samples"""

    def of(self, columns: IndexArray) -> RunScores:
        """Scores of these `columns` alone."""
        return self._replace(scores=tuple(one.of(columns) for one in self.scores))


def score_runs(signals: Sequence[SignalSet], problem_of: Problem, fitted: LatentProblem, state: State) -> RunScores:
    """Score of each run of `signals` at `state`; of a single run of each of its segments.

    `problem_of` returns the problem of some gap-free segments, as `fitted` is that of all. The scores of runs add up to
    that of the fit; segments lose the equation of motion between them. Costs one Gauss-Newton step.
    """
    parts = by_run(signals)
    found = [(run, score_at(problem_of(own), replace(state, x=state.x.of(where), noise=state.noise.at(where))), where)
             for run, own, where in (parts if len(parts) > 1 else segments(signals, fitted, state))]
    if not found:
        return RunScores((parts[0][0],), ())
    names, scores, places = zip(*found, strict=True)
    return RunScores(names, scores, "run" if len(parts) > 1 else "segment", places)


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
