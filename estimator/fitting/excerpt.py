"""`excerpt`: the first part of each segment of a long record, which tells as much of its noise as the whole."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import IndexArray
from estimator.signals import LEAST_SEGMENT, SignalSet, cut


def excerpt(signals: Sequence[SignalSet], most: float) -> tuple[list[SignalSet], IndexArray]:
    """Segments of about `most` samples in all, each the same share of its own, and the numbers (k,) of these samples in
    the whole record."""
    lengths = np.array([len(s.time_s) for s in signals])
    share = min(1.0, most / int(lengths.sum()))
    parts = [cut(s, slice(0, max(LEAST_SEGMENT, round(share * len(s.time_s))))) for s in signals]
    starts = np.cumsum(lengths) - lengths
    return parts, np.concatenate([start + np.arange(len(s.time_s)) for s, start in zip(parts, starts, strict=True)])
