"""`omitted_effects`: listed effects that a fit shows and lacks, and that would move its parameters.

Score tests (Rao, Proc. Cambridge Phil. Soc. 44, 1948) of `estimator.score`: the motion and the parameters are projected
out. A Gauss-Newton step with the size free changes the parameters by -H^-1 I_es times the size, with H the information
on them and I_es that on both.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import BoolArray
from estimator.likelihood import Candidate, LatentProblem, Stage, State
from estimator.result import MOST_DISAGREEMENT, FitResult, OmittedEffect
from estimator.score import ALPHA, RunScores, columns_of, project
from estimator.signals import SignalSet


def with_candidates(problem: LatentProblem, signals: Sequence[SignalSet], some: Sequence[SignalSet], state: State,
                    candidates: Sequence[Candidate], gear_ratio: float = 1.0) -> LatentProblem:
    """The likelihood of `some` of the `signals` of `problem`, with scores of `candidates`."""
    names = list(dict.fromkeys(one.run for one in signals))
    reach = np.stack([state.x.q.min(axis=0), state.x.q.max(axis=0)], axis=-1)
    if problem.stage.angle_range.any():  # sizes of its effects refer to that
        known = np.ptp(problem.stage.angle_range, axis=1, keepdims=True) > 0.0
        reach = np.where(known, problem.stage.angle_range, reach)
    first = {name: next(one for one in signals if one.run == name) for name in names}  # clocks may count from 1970
    lengths = [sum(len(one.time_s) for one in signals if one.run == name) / first[name].rate_hz for name in names]
    starts = dict(zip(names, np.cumsum([0.0, *lengths[:-1]]).tolist(), strict=True))
    begin = tuple(float(one.time_s[0] - first[one.run].time_s[0]) for one in some)
    session = tuple(starts[one.run] + since for one, since in zip(some, begin, strict=True))
    stage = Stage(tuple(names.index(one.run) for one in some), session, begin, reach, gear_ratio)
    found = LatentProblem(some, problem.mechanism, problem.collocation.hold, stage, problem.effects, candidates)
    return found.with_disturbance() if problem.disturbed else found


def omitted_effects(result: FitResult, scores: RunScores, free: BoolArray, candidates: Sequence[Candidate]
                    ) -> tuple[OmittedEffect, ...]:
    """Effects that the runs show at the optimum, the most significant first; none of a run too short for its scores, or
    where no parameter was estimated.

    Each would move a parameter by more than `MOST_DISAGREEMENT` half widths of its interval. `free` (m,) are the
    parameters that were estimated; those of the result come first, and the sizes of `candidates` follow.
    """
    if not scores.scores or not candidates or not free[: len(result.beta)].any():
        return ()
    taken = np.flatnonzero(free)
    further = free.size + np.arange(sum(one.width for one in candidates))
    tests = project(scores.of(np.concatenate([taken, further])).scores, taken.size)
    effects = [(one.effect, columns) for one, columns in zip(candidates, columns_of(candidates))]
    # the size of a gear's inner friction alone is no elastic gear: what defines an effect is tested
    tried = [(effect, which, k) for effect, columns in effects
             for which, k in enumerate(map(int, columns[: effect.defining]))
             if effect.distinguishing_size in (None, which) and tests.information[k, k] > 0.0]
    inside = taken < len(result.beta)
    half = result.shown_half_width[taken[inside]]
    found = []
    for effect, which, k in tried:
        p_value = tests.p_value(np.array([k])) * len(tried)
        step = float(tests.size(np.array([k]))[0])
        sizes = np.append(step * (np.arange(len(effect.sizes)) == which), effect.usual or ())
        moved = np.abs(step * tests.carry[inside, k]) / np.where(half > 0.0, half, np.inf)
        first = int(np.argmax(moved))
        # a gain scales all parameters: its score only says that less of everything leaves less, a size below -1
        if p_value < ALPHA and moved[first] > MOST_DISAGREEMENT and effect.possible(sizes):
            name = result.mechanism.names[taken[first]]
            found.append(OmittedEffect(effect.key, p_value, name, float(moved[first])))
    return tuple(sorted(found, key=lambda one: one.p_value))
