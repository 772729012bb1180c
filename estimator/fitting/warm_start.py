"""Start of a long record's fit from an excerpt of it: parameters and noise levels need few samples to be nearly right.

Most steps of a fit go by before its noise levels are known. An excerpt takes them at a fraction of their cost, and
the whole record then needs only the last few. An excerpt that shows too little is not used.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import BoolArray
from estimator.errors import FitError
from estimator.fitting.gauss_newton import Policies, descend
from estimator.fitting.identifiability import undetermined
from estimator.fitting.initial_guess import noise_floors
from estimator.likelihood import LatentProblem, Latents, State
from estimator.options import FitOptions
from estimator.signals import LEAST_SEGMENT, SignalSet, cut

SHARE = 8
"""The excerpt is one part in so many."""
LEAST = 400
"""Fewest samples of it."""
PARTS = 3
"""It is at most one part in so many: a record that has fewer samples is fitted as it is."""
STEPS = 15
"""Most steps that are spent on an excerpt."""
OUTLIER = 4.0
"""Squares of signals are clipped here, in variances, when excitation is compared: a knock excites little."""


def from_excerpt(problem: LatentProblem, signals: Sequence[SignalSet], options: FitOptions, free: BoolArray,
                 start: State, seeks_smoothing: bool) -> State | None:
    """`start` with parameters and noise levels of an excerpt; None where that was not to be had."""
    parts = excerpt(problem, signals, start.x)
    if not parts:
        return None
    chosen = [cut(signals[i], where) for i, where in parts]
    offsets = problem.ends - [len(s.time_s) for s in signals]
    index = np.concatenate([offsets[i] + np.arange(where.start, where.stop) for i, where in parts])
    small = LatentProblem(chosen, problem.mechanism, options.hold)
    x = start.x.of(index)
    state = State(x, start.beta, start.noise, start.covariance)
    before = from_excerpt(small, chosen, options, free, state, seeks_smoothing) or state
    try:
        floors = noise_floors(small, problem.mechanism, start.beta)
        before = descend(small, before, free, Policies.of(options, floors, seeks_smoothing, rough=True), STEPS)
    except FitError:
        return None
    if not before.converged or undetermined(problem.mechanism, before.beta, before.covariance, free):
        return None
    return State(start.x, before.beta, before.noise.levels(), start.covariance, misfit=before.misfit,
                 smoothing=before.smoothing)


def excerpt(problem: LatentProblem, signals: Sequence[SignalSet], x: Latents) -> list[tuple[int, slice]]:
    """Segments, by number, and the samples of each that are excited most; empty where there is nothing to gain."""
    wanted = max(LEAST, problem.total // SHARE)
    if wanted * PARTS > problem.total:
        return []
    values = np.hstack([x.v, x.u])
    spread = np.maximum(values.std(axis=0), 1e-300)
    power = np.minimum(((values - values.mean(axis=0)) / spread) ** 2, OUTLIER).sum(axis=1)
    lengths = [len(s.time_s) for s in signals]
    share = wanted / max(sum(n for n in lengths if n >= LEAST_SEGMENT), 1)
    found = []
    for i, (part, n) in enumerate(zip(np.split(power, problem.ends[:-1]), lengths)):
        size = min(n, max(LEAST_SEGMENT, round(share * n)))
        if size < LEAST_SEGMENT:
            continue
        total = np.concatenate([[0.0], np.cumsum(part)])
        first = int(np.argmax(total[size:] - total[: n - size + 1]))
        found.append((i, slice(first, first + size)))
    taken = sum(where.stop - where.start for _, where in found)
    return found if taken >= LEAST and taken * PARTS <= problem.total else []
