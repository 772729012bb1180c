"""`Stage` and `Timeline`: when and in which run samples were taken; `Candidate`: an effect to be scored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from daq import FloatArray, IndexArray
from estimator.effects import Effect
from estimator.model import GAUSS
from estimator.signals import SignalSet


@dataclass(frozen=True)
class Candidate:
    """An effect at one point of its shape grid, to be scored at zero size."""

    effect: Effect
    shape: tuple[float, ...] = ()

    @property
    def width(self) -> int:
        """Number of columns: one a size."""
        return len(self.effect.sizes)


@dataclass(frozen=True)
class Stage:
    """Places and times of the segments of a record: what a `View` needs beyond the motion."""

    run: tuple[int, ...]
    """Number of the run of each segment."""
    session_s: tuple[float, ...]
    """Session time of each segment's first sample."""
    time_s: tuple[float, ...]
    """Time since the start of its run of each segment's first sample."""
    angle_range: FloatArray
    """(n, 2)"""
    gear_ratio: float = 1.0

    @classmethod
    def blank(cls, segments: int, joints: int) -> Self:
        """Stage of effects that need none of it."""
        zeros = (0.0,) * segments
        return cls((0,) * segments, zeros, zeros, np.zeros((joints, 2)))


class Timeline(NamedTuple):
    """Times and runs of every sample (N,), or of the Gauss points of every interval (2, K)."""

    time: FloatArray
    """Since the start of the run [s]."""
    session: FloatArray
    """In the session [s]."""
    run: FloatArray
    """Number of the run."""
    exchanged: FloatArray
    """1 where a walker's legs have changed places."""

    @classmethod
    def of(cls, stage: Stage, signals: Sequence[SignalSet], dt: float) -> Self:
        """At the samples of `signals`, which follow each other every `dt` [s]."""
        lengths = [len(s.time_s) for s in signals]
        since = np.concatenate([np.arange(k) for k in lengths]) * dt
        return cls(np.repeat(stage.time_s, lengths) + since, np.repeat(stage.session_s, lengths) + since,
                   np.repeat(np.asarray(stage.run, dtype=np.float64), lengths),
                   np.repeat([float(s.exchanged) for s in signals], lengths))

    def at_gauss(self, left: IndexArray) -> Timeline:
        """At the Gauss points of the intervals that begin at samples `left` (K,)."""
        def between(values: FloatArray) -> FloatArray:
            return np.stack([values[left] + w * (values[left + 1] - values[left]) for w in GAUSS])

        both = 2, left.size
        return Timeline(between(self.time), between(self.session), np.broadcast_to(self.run[left], both),
                        np.broadcast_to(self.exchanged[left], both))
