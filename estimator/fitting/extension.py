"""`extend`: a fit with effects that are none of its parameters, estimated together with these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from daq import BoolArray, FloatArray
from estimator.effects import Effect
from estimator.fitting.gauss_newton import iterate
from estimator.fitting.initial_guess import noise_floors
from estimator.likelihood import LatentProblem, Noise, Stage, State
from estimator.options import FitOptions
from estimator.result import LoopTerm
from estimator.signals import SignalSet

Terms = tuple[tuple[Effect, FloatArray], ...]
"""Terms that are estimated with a fit, and are none of its parameters."""
PRIOR = 5.0
"""Log-likelihood below which two holds are hardly told apart."""


class HoldChoice(NamedTuple):
    """The likeliest way in which torque acts between samples."""

    hold: str
    margin: float
    """Log-likelihood above that of the next."""
    next: str
    delay_s: float = 0.0
    """How long after the hold says the torque acts, where that is likelier than not at all [s]."""
    imu_age_s: float = 0.0
    """How late the IMU is against encoder and torque, likewise [s]."""
    apart_s: float = 0.0
    """How much later the torque acts by the next hold with its own delay, where the evidence hardly tells both apart
    [s]."""

    @property
    def delays_s(self) -> tuple[float, ...]:
        """The delay, where there is one; then that by the next hold, where that is hardly told apart."""
        return (self.delay_s, self.delay_s + self.apart_s)[: bool(self.delay_s) * (1 + bool(self.apart_s))]

    def __str__(self) -> str:
        if self.next == self.hold:
            return "it acts as late as these data ask without a delay; declare hold under [sampling] where it is known"
        if self.margin < PRIOR:
            return (f"these data hardly separate it from '{self.next}' (log-likelihood {self.margin:+.1f}); declare "
                    "hold under [sampling]")
        return f"the likeliest; the next, '{self.next}', has a log-likelihood {self.margin:.3g} below"


class ExtendedFit(NamedTuple):
    """A fit, which each of `mle.CANDIDATES` makes another one where the records ask for it."""

    problem: LatentProblem
    state: State
    """Without the sizes of its `terms`"""
    signals: list[SignalSet]
    free: BoolArray
    options: FitOptions
    terms: Terms = ()
    loop: tuple[LoopTerm, ...] = ()
    said: tuple[str, ...] = ()
    """Sentences about what was added, or was not"""
    bound_s: float = 0.0
    """See `Dataset.clock_bound_s`"""
    age_s: float = 0.0
    """By which the readings of the IMU were moved before the fit"""
    chosen: HoldChoice | None = None
    """None of a hold that is stated"""

    @property
    def whole(self) -> tuple[LatentProblem, State]:
        """Its problem and state with its `terms`."""
        if not self.terms:
            return self.problem, self.state
        beta = np.concatenate([self.state.beta, *(size for _, size in self.terms)])
        effects = [effect for effect, _ in self.terms]
        return extended(self.problem, self.signals, effects), replace(self.state, beta=beta)


def extended(problem: LatentProblem, signals: Sequence[SignalSet], effects: Sequence[Effect]) -> LatentProblem:
    """The likelihood of segments as `problem` has it, with effects; the range of angles is that of the encoders."""
    seen = problem.angles[:, problem.has_encoder]
    reach = np.zeros((problem.n, 2))
    reach[problem.has_encoder] = np.stack([seen.min(axis=0), seen.max(axis=0)], axis=-1)
    blank = Stage.blank(len(signals), problem.n)
    found = LatentProblem(signals, problem.mechanism, problem.collocation.hold, replace(blank, angle_range=reach),
                          effects)
    return found.with_disturbance() if problem.disturbed else found


def extend(fitted: ExtendedFit, extra: Terms, sought: BoolArray, noise: Noise) -> tuple[LatentProblem, State]:
    """Problem and fit with terms, from their sizes, of which those `sought` (m,) are free, and from this `noise`.

    Raises `FitError`.
    """
    wide, begin = fitted._replace(terms=extra).whole
    begin = replace(begin, noise=noise, covariance=np.zeros((begin.beta.size,) * 2))
    return wide, iterate(wide, begin, np.append(fitted.free, sought), fitted.options,
                         noise_floors(wide, wide.mechanism, fitted.state.beta))


def without_sizes(before: State, again: State) -> State:
    """The state of a fit with terms, which followed that `before`, without their sizes."""
    p = before.beta.size
    return replace(again, beta=again.beta[:p], covariance=again.covariance[:p, :p],
                   iterations=before.iterations + again.iterations)
