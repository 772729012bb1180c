"""`steps_without`: where parameters move to without a part of their data."""

from __future__ import annotations

import numpy as np

from daq import BoolArray, FloatArray
from estimator.numerics import inverse_root
from estimator.score.run_scatter import arrays
from estimator.score.run_scores import RunScores

PARTS = 4
"""Of a single run."""


def steps_without(scores: RunScores, free: BoolArray, known: FloatArray | None = None
                  ) -> list[tuple[slice, FloatArray]]:
    """Samples of each run, or of each of PARTS parts of a single one, with the step (m,) to the fit without it.

    Empty without at least two. The step is -(I - I_k)^-1 s_k, s_k and I_k score and information of the part, I that of
    all runs and what is `known` (p, p) from elsewhere. `free` (m,) has the estimated parameters.
    """
    count, index, found = len(scores.scores), np.flatnonzero(free), []
    if count < 2 or not index.size:
        return []
    parts = np.array_split(np.arange(count), count if scores.unit == "run" else PARTS)
    score, information = arrays(scores.scores)
    whole = information.sum(axis=0)
    if known is not None:
        whole[: len(known), : len(known)] += known
    for part in parts:
        left, step = whole - information[part].sum(axis=0), np.zeros(free.size)
        root = inverse_root(left[np.ix_(index, index)])
        step[index] = -root @ (root.T @ score[part].sum(axis=0)[index])
        found.append((slice(scores.places[part[0]].start, scores.places[part[-1]].stop), step))
    return found
