"""`omitted_effects`: listed effects that a fit shows and lacks, and that would move its parameters.

Score tests (Rao, Proc. Cambridge Phil. Soc. 44, 1948): the score of an effect's size at zero, the motion and the
parameters projected out, has mean zero if the effect is absent. Its variance is its information times the scatter
between segments of the runs, at least that of white noise. A Gauss-Newton step with the size free
changes the parameters by -H^-1 I_es times the size, with H the information on them and I_es that on both.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from daq import FloatArray
from estimator.effects import Effect, SensorTimeSkew, library
from estimator.fitting.run_scores import score_at, segments
from estimator.likelihood import Candidate, LatentProblem, Stage, State
from estimator.numerics import pseudo_inverse
from estimator.result import MOST_DISAGREEMENT, FitResult, OmittedEffect
from estimator.signals import SignalSet

SURE = 0.01
"""Probability, over all sizes tested, below which an effect is there."""
IMITATED = 1e-3
"""Share of its information that is left when the parameters are projected out, below which they imitate an effect."""


def omitted_effects(result: FitResult, problem: LatentProblem, signals: Sequence[SignalSet], state: State,
                    free: NDArray[np.bool_], skew: float | None = None) -> tuple[OmittedEffect, ...]:
    """Effects without shapes that the runs show at `state`, the most significant first.

    Each would move a parameter by more than `MOST_DISAGREEMENT` half widths of its interval. None of runs too short for
    segments, without which the scatter is unknown.

    `free` (p,) are the parameters that were estimated, `skew` [s] is by how much the fit takes the IMU to be late.
    """
    own = () if skew is None else (SensorTimeSkew(),)
    candidates = tuple(Candidate(effect) for effect in _small(problem) if skew is None or
                       not isinstance(effect, SensorTimeSkew))
    beta = state.beta if skew is None else np.append(state.beta, skew)
    taken = np.flatnonzero(free if skew is None else np.append(free, True))
    names = list(dict.fromkeys(one.run for one in signals))
    reach = np.stack([state.x.q.min(axis=0), state.x.q.max(axis=0)], axis=-1)

    def extended(some: Sequence[SignalSet]) -> LatentProblem:
        begin = tuple(float(one.time_s[0]) for one in some)
        stage = Stage(tuple(names.index(one.run) for one in some), begin, begin, reach)
        found = LatentProblem(some, problem.mechanism, problem.collocation.hold, stage, own, candidates)
        return found.with_disturbance() if problem.disturbed else found

    parts = segments(signals, problem, state)
    if not parts:
        return ()
    scored = [score_at(extended(some), state.x.of(where), beta, state.noise.at(where)) for _, some, where in parts]
    score, information = (np.array(values) for values in zip(*scored, strict=True))
    effects = [(one.effect, k) for one in candidates for k in range(one.width)]
    tests = list(_tests(score, information, taken, beta.size, [k for k, (effect, size) in enumerate(effects) if
                                                   effect.distinguishing_size in (None, size)]))
    found = [_omitted(effects[k][0], p * len(tests), change[taken < free.size], result, taken[taken < free.size])
             for k, p, change in tests if p * len(tests) < SURE]
    return tuple(sorted((one for one in found if one.half_widths > MOST_DISAGREEMENT), key=lambda one: one.p_value))


def _small(problem: LatentProblem) -> list[Effect]:
    """Effects that small sizes define."""
    encoders = [int(j) for j in np.flatnonzero(problem.has_encoder)]
    return [effect for effect in library(problem.mechanism, problem.has_imu, encoders)[0] if not effect.shapes]


def _tests(scores: FloatArray, informations: FloatArray, free: NDArray[np.intp], count: int, sizes: Sequence[int]
           ) -> Iterator[tuple[int, float, FloatArray]]:
    """(size, p-value, change of the free parameters) of each size that these do not imitate.

    Scores (R, m) and informations (R, m, m) of segments are those of `count` parameters, then of all sizes.
    """
    whole = informations.sum(axis=0)
    inverse = pseudo_inverse(whole[np.ix_(free, free)])
    units = len(scores)
    for size in sizes:
        column = count + size
        carried = inverse @ whole[free, column]
        score = scores[:, column] - scores[:, free] @ carried
        own = informations[:, column, column] - 2.0 * informations[:, column, free] @ carried
        own = own + np.einsum("i,rij,j->r", carried, informations[:, free[:, None], free], carried)
        information = float(own.sum())
        if not information > IMITATED * whole[column, column]:
            continue
        apart = (score - own / information * score.sum()) ** 2 / np.maximum(own, 1e-300)
        scatter = max(1.0, float(apart.sum()) / (units - 1))
        gain = float(score.sum()) ** 2 / information / scatter
        yield size, float(fdtrc(1, units - 1, gain)), -carried * float(score.sum()) / information


def _omitted(effect: Effect, p_value: float, change: FloatArray, result: FitResult, free: NDArray[np.intp]
             ) -> OmittedEffect:
    """With the parameter that it moves furthest."""
    half = result.half_width[free]
    moved = np.where(half > 0.0, np.abs(change) / np.where(half > 0.0, half, 1.0), 0.0)
    k = int(np.argmax(moved))
    return OmittedEffect(effect.key, p_value, result.mechanism.names[free[k]], float(moved[k]))
