"""Parameters about which the runs of a fit disagree."""

from __future__ import annotations

import numpy as np

from estimator import FitResult

WIDENED = 1.05
"""Intervals wider than this by what runs disagree about are said to be."""


def disputed(result: FitResult) -> list[int]:
    """Numbers of the determined parameters about which the runs are seen to disagree, wide enough for an interval."""
    found = result.agreement
    if found is None or not found.disagree:
        return []
    told = result.widening > WIDENED
    if found.seen.size:  # none of what an older model file tells
        told = told & found.seen
    return [int(k) for k in np.flatnonzero(told) if result.mechanism.names[k] not in result.open_parameters]


def units(result: FitResult) -> str:
    """Units that may disagree: runs, or segments of a single run."""
    return f"{'run' if result.agreement is None else result.agreement.unit}s"
