"""`FittedModel`: a mechanism with values for its parameters and those of effects, and what a fit says of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq import FloatArray
from estimator.effects import Effect
from estimator.likelihood import Candidate, LatentProblem, Noise, Stage
from estimator.model import Mechanism
from estimator.signals import SignalSet


@dataclass(frozen=True)
class FittedModel:
    """All that a free run needs of a model; a plain model is one with no effects."""

    mechanism: Mechanism
    hold: str
    parameters: FloatArray
    """(m,) beta (p,), then the sizes and shapes of each effect"""
    effects: tuple[Effect, ...] = ()
    covariance: FloatArray | None = None
    """(m, m) of the parameters, NaN where not determined; None where it is not known"""
    noise: Noise | None = None
    """Levels of the fit; None where they are not known"""
    angle_range: FloatArray | None = None
    """(n, 2) smallest and largest angle of each joint in the runs fitted [rad]; effects may depend on it"""
    gear_ratio: float = 1.0

    @property
    def beta(self) -> FloatArray:
        """Parameters beta (p,)."""
        return self.parameters[: self.mechanism.p]

    @property
    def reach(self) -> FloatArray:
        """(n, 2) `angle_range`, zero where it is not known."""
        return np.zeros((self.mechanism.n, 2)) if self.angle_range is None else self.angle_range

    def problem(self, signals: Sequence[SignalSet], session_s: float = 0.0, candidates: Sequence[Candidate] = ()
                ) -> LatentProblem:
        """Likelihood of the segments of one run, which begins at `session_s` [s] of its session; with columns for
        `candidates`, if there are any."""
        begin = tuple(float(s.time_s[0] - signals[0].time_s[0]) for s in signals)
        stage = Stage((0,) * len(begin), tuple(session_s + b for b in begin), begin, self.reach, self.gear_ratio)
        return LatentProblem(signals, self.mechanism, self.hold, stage, self.effects, candidates)
