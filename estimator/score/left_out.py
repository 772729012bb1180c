"""`step_without`: where parameters move to without a part of their data."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from daq import BoolArray, FloatArray
from estimator.score.run_scores import RunScores
from estimator.score.score import Score, total

PARTS = 4
"""Of a single run."""


def step_without(scores: Sequence[Score], free: BoolArray, part: Collection[int]) -> FloatArray:
    """(m,) step of the `free` parameters (m,) from the optimum of all `scores` to that without those in `part`.

    It is I^-1 s, s and I the score and information of the others together.
    """
    step = np.zeros(free.size)
    if free.any():
        index = np.flatnonzero(free)
        step[index] = total([one.of(index) for k, one in enumerate(scores) if k not in part]).size()
    return step


def steps_without(scores: RunScores, free: BoolArray, known: FloatArray | None = None
                  ) -> list[tuple[slice, FloatArray]]:
    """Samples of each run, or of each of PARTS parts of a single one, with `step_without` it; empty without two.

    What is `known` from elsewhere has the information (p, p). At the optimum its score balances that of all runs.
    """
    count, every = len(scores.scores), list(scores.scores)
    if count < 2:
        return []
    if known is not None:
        both = np.zeros_like(every[0].information)
        both[: len(known), : len(known)] = known
        every.append(Score(-total(every).score, both))
    parts = np.array_split(np.arange(count), count if scores.unit == "run" else PARTS)
    return [(slice(scores.places[part[0]].start, scores.places[part[-1]].stop), step_without(every, free, set(part)))
            for part in parts]
