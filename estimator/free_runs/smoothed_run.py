"""`SmoothedRun`: the motion of one run from which its free runs start."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from daq import FloatArray
from estimator.likelihood import LatentProblem, Noise, State
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
        """-2 log density of readings and motion at this motion, up to a constant that all models of the run share.

        Under `noise`, by default the run's own levels. The density is that of the likeliest motion, not integrated
        over motions.
        """
        noise = (noise or self.state.noise).with_samples_of(self.state.noise)
        objective = self.problem.motion_equations(self.state.x, self.state.beta, noise).objective
        return objective + 2.0 * self.problem.log_volume(noise)
