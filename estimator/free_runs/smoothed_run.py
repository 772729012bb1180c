"""`SmoothedRun`: the motion of one run from which its free runs start."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from daq import FloatArray
from estimator.likelihood import LatentProblem, Noise, State, log_marginal
from estimator.signals import SignalSet


@dataclass(frozen=True)
class SmoothedRun:
    """The likeliest motion of one run."""

    run: str
    signals: tuple[SignalSet, ...]
    """Its gap-free segments"""
    problem: LatentProblem
    state: State

    @cached_property
    def drive(self) -> FloatArray:
        """(N, n) measured torque, less what the model's effects add to its reading [N m]."""
        return self.problem.torque - self.problem.torque_readings(self.state.x, self.state.beta)

    def misfit(self, noise: Noise | None = None) -> float:
        """-2 `log_marginal` at this motion, under `noise`, by default the run's own levels."""
        own = self.state.noise
        noise = replace(noise or own, scale=own.scale, stiction=own.stiction)
        return -2.0 * log_marginal(self.problem, replace(self.state, noise=noise))
