"""Hold of the torque between samples, chosen by the likelihood together with its delay where nobody states it.

Samples alone do not tell a torque that is held from one that ramps, or that a fast controller made. The motion between
them does: each way moves the links a little differently. A delay does the same, and half a sample of it is the
difference between two holds. So each hold is asked with a delay of the torque, and with one of the IMU, which are free.
Marginal likelihoods (`marginal_at`) are compared at the noise levels of one fit.
A hold's evidence is the larger of two: that without a delay, and that with one, integrated over a prior of the delay
(Jeffreys, Theory of probability, 1961). A hold that needs no delay therefore goes before one that does. Where all need
one, a torque that is held and a smooth one are compared, each exactly as late as it likes.

The curve of a smooth torque is that of the fit's latents here, not of the measured torque as in a fit: the measured
torque's noise e enters as (1 + h(omega)) e, and costs the sum over frequencies of h, up to 18 in 2,000 samples,
whatever is true; so `linear` won by 9 where inertias were 1.4 standard deviations better with `smooth`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from daq import BoolArray, FloatArray, IndexArray
from estimator.effects import Effect, SensorTimeSkew, TorqueDelay
from estimator.errors import FitError
from estimator.fitting.excerpt import excerpt
from estimator.fitting.extension import PRIOR, ExtendedFit, HoldChoice
from estimator.fitting.gauss_newton import iterate
from estimator.fitting.imu_age import LATEST_S
from estimator.fitting.initial_guess import noise_floors
from estimator.fitting.newton_step import newton_step
from estimator.likelihood import LatentProblem, Latents, Noise, State, marginal_at
from estimator.model import HELD, HOLDS, PAST, TICKS, Mechanism, lag
from estimator.numerics import eliminate
from estimator.options import FitOptions
from estimator.signals import LEAST_SEGMENT, SignalSet, cut

FIRST = "smooth"
"""The hold of the fit at whose noise levels the others are compared."""
TRIED = tuple(hold for hold in HOLDS if hold != "average" and not hold.startswith(f"{PAST}/"))
"""Holds that are chosen from. `average` is as late as `smooth`, and wins against it by what an accelerometer sees of
steps: it has to be stated. past/N is that of a file with N samples for one of the grid."""
RARE = {"linear": 15.0, PAST: 3.0}
"""Log-likelihood by which such a hold must beat the others: a torque with a corner at every sample of the grid is made
by a plant on that grid, and a mean over the past by a logger, seldom by a rig's controller. (Measured under a PD loop
of 1 kHz, logged at 200 Hz: `linear` is 9 to 13 ahead of the true hold.)"""
DELAY_S = 0.01
"""Standard deviation of a delay that nobody states [s]."""
KNOWN, KNOWN_S = 0.05, 2e-4
"""Standard deviation of how late a hold without a delay, or an IMU without an age, may be [samples] and [s]: no model
of a leg tells less."""
EXCERPT = 2000
"""Fewest samples of a record that are looked at: of each segment its first part."""
SHARE = 4
"""Of a longer record one sample in so many is looked at."""
LOST = 100.0
"""A hold so far behind the best after the first step, in log-likelihood, is taken no further."""
REACH = 0.5
"""Samples on both sides of a smooth torque's delay in which that of a held one is sought."""
FREED = 30
"""Steps of the fit with free delays, whose noise levels all holds share."""


def choose_hold(fit: ExtendedFit) -> HoldChoice:
    """The likeliest of `TRIED` given the fit of one of them; parameters that are not free stay."""
    (fitted, state, signals, free, options, *_), mechanism = fit, fit.problem.mechanism
    parts, index = excerpt(signals, max(EXCERPT, fitted.total // SHARE))
    delays: tuple[Effect, ...] = (TorqueDelay(),) if mechanism.actuated else ()
    delays += (SensorTimeSkew(),) if fitted.has_imu else ()
    begin = State(state.x.of(index), np.append(state.beta, np.zeros(len(delays))), state.noise.at(index),
                  np.zeros((0, 0)))
    whole = np.append(free, np.ones(len(delays), bool))
    begin = _freed(LatentProblem(parts, mechanism, FIRST, effects=delays), begin, whole, options)
    age = _age(begin, fitted.dt) if fitted.has_imu and begin.converged else 0.0
    tried, runners = _tried(signals), {}
    for hold in tried:
        beta = begin.beta.copy()
        if mechanism.actuated:
            beta[mechanism.p] += (lag(hold) - lag(FIRST)) * fitted.dt
        problem = LatentProblem(parts, mechanism, hold, effects=delays).curved_by(begin.x.u)
        runners[hold] = _Runner(problem, begin.x, beta, begin.noise, np.flatnonzero(whole))
    found = {hold: runner.step() for hold, runner in runners.items()}
    ahead = max(one.value for one in found.values()) - LOST
    found |= {hold: runners[hold].step() for hold in tried if found[hold].value > ahead}
    values = {hold: one.without - RARE.get(hold.partition("/")[0], 0.0) for hold, one in found.items()}
    best, second, *_ = sorted(values, key=lambda hold: -values[hold])
    if not np.isfinite(found[best].without):
        return HoldChoice(FIRST, 0.0, HELD)
    late = _delayed(parts, mechanism, begin, delays, np.flatnonzero(whole), tried) if found[best].delay_s else None
    if late is not None:
        return late._replace(imu_age_s=age)
    return HoldChoice(best, found[best].without - found[second].without, second, 0.0, age)


def _tried(signals: Sequence[SignalSet]) -> tuple[str, ...]:
    """Holds that these samples may have."""
    samples = signals[0].averaged
    if samples < 1.5:
        return TRIED
    nearest = min(TICKS, key=lambda n: abs(n - samples))
    return (*TRIED, f"{PAST}/{nearest}") if samples < 1.5 * nearest else TRIED


def _delayed(parts: Sequence[SignalSet], mechanism: Mechanism, begin: State, delays: tuple[Effect, ...],
             free: IndexArray, tried: Sequence[str]) -> HoldChoice | None:
    """The likelier of a held and a smooth torque, each with its likeliest delay.

    `TorqueDelay` delays the smooth one. The held one moves by whole samples, and steps within a sample. A hold that is
    as late by its definition goes before a delay, whatever the shape of the steps says: no record shows what an IMU and
    a log do between samples. None where segments are too short, and where no fit of either can be made.
    """
    from scipy.optimize import minimize_scalar  # 0.15 s to import

    rate, p = parts[0].rate_hz, mechanism.p
    edge = int(np.ceil(LATEST_S * rate)) + 2
    kept = [k for k, s in enumerate(parts) if len(s.time_s) > 2 * edge + LEAST_SEGMENT // 2]
    if not kept:
        return None
    ends = np.cumsum([len(s.time_s) for s in parts])
    inside = np.concatenate([np.arange(ends[k] - len(parts[k].time_s) + edge, ends[k] - edge) for k in kept])
    start = State(begin.x.of(inside), begin.beta, begin.noise.at(inside), begin.covariance)

    def late_by(whole: int) -> list[SignalSet]:
        own = [cut(parts[k], slice(edge, len(parts[k].time_s) - edge)) for k in kept]
        return [replace(s, torque=parts[k].torque[edge - whole : edge - whole + len(s.time_s)])
                for s, k in zip(own, kept, strict=True)]

    def held(delay: float) -> float:
        """Log-likelihood of a torque that is held from `delay` samples after its stamp."""
        whole = int(np.ceil(delay))
        problem = LatentProblem(late_by(whole), mechanism, HELD, effects=delays[1:]).delayed(delay - whole + 1.0)
        others = free[free != p]
        runner = _Runner(problem, start.x, np.delete(start.beta, p), start.noise, others - (others > p))
        runner.step(False)
        return runner.step(False).value

    smooth = _Runner(LatentProblem(late_by(0), mechanism, FIRST, effects=delays).curved_by(start.x.u), start.x,
                     start.beta.copy(), start.noise, free)
    smooth.step()
    line = smooth.step()
    if not np.isfinite(line.optimum):
        return None
    centre = -float(smooth.beta[p])
    about, most = np.clip(rate * centre - lag(HELD), -LATEST_S * rate, LATEST_S * rate), LATEST_S * rate
    at = minimize_scalar(lambda delay: -held(delay), method="bounded", options={"xatol": 0.002},
                         bounds=(max(about - REACH, -most), min(about + REACH, most)))
    delay, best = float(at.x), -float(at.fun)
    if not np.isfinite(best):
        return HoldChoice(FIRST, np.inf, HELD, centre)
    fall = best - held(delay + KNOWN) + best - held(delay - KNOWN)
    ahead = best - line.optimum
    ways = [(FIRST, centre, line.std_s, tried, -ahead),
            (HELD, (delay + lag(HELD)) / rate, KNOWN / np.sqrt(max(fall, 1e-6)) / rate, (HELD, PAST), ahead)]
    for family, late, std, holds, margin in sorted(ways, key=lambda way: -way[-1]):
        nearest = holds[int(np.argmin(np.abs(rate * late - np.array([lag(hold) for hold in holds]))))]
        if not _evidence(0.0, late - lag(nearest) / rate, std, 1.0 / rate).delay_s:
            return HoldChoice(nearest, margin, HELD if family == FIRST else FIRST)
    # an error of KNOWN samples costs that much: a smaller difference does not tell two shapes apart
    alike = max(PRIOR, 0.5 * (KNOWN / rate / line.std_s) ** 2 if line.std_s else 0.0)
    apart = (centre - (delay + lag(HELD)) / rate) * (abs(ahead) <= alike)
    if ahead > -alike:
        return HoldChoice(HELD, ahead, FIRST, delay / rate, apart_s=apart)
    return HoldChoice(FIRST, -ahead, HELD, centre)


def _freed(problem: LatentProblem, begin: State, free: BoolArray, options: FitOptions) -> State:
    """`begin` after some steps with free delays. Its noise levels no longer hold what a delay explains."""
    try:
        return iterate(problem, begin, free, replace(options, prior={}), noise_floors(
            problem, problem.mechanism, begin.beta[: problem.mechanism.p]), FREED)
    except FitError:
        return begin


def _age(freed: State, dt_s: float) -> float:
    """How late the IMU is by a fit in which that is the last parameter [s]; 0 where no age is as likely."""
    return _evidence(0.0, float(freed.beta[-1]), float(np.sqrt(freed.covariance[-1, -1])), dt_s).delay_s


class _Evidence(NamedTuple):
    value: float
    """Log of the evidence, without the part that all holds share."""
    delay_s: float = 0.0
    """0 where none is likelier."""
    optimum: float = -np.inf
    """Log-likelihood with the likeliest delay"""
    std_s: float = 0.0
    """Standard deviation of that delay"""
    without: float = -np.inf
    """Log-likelihood without a delay"""


@dataclass
class _Runner:
    """One hold on its way to its own optimum: their difference is small, and nearly linear."""

    problem: LatentProblem
    x: Latents
    beta: FloatArray
    noise: Noise
    free: IndexArray

    def step(self, delays: bool = True) -> _Evidence:
        """Evidence predicted for the optimum; one Gauss-Newton step. `delays`: the first effect is the torque's.

        -inf where the equations cannot be solved, and where the step diverges.
        """
        problem, index = self.problem, self.free
        p = problem.mechanism.p
        point = problem.linearise(self.x, self.beta, self.noise)
        try:
            solved = eliminate(point.chain)
        except np.linalg.LinAlgError:
            return _Evidence(-np.inf)
        step = newton_step(point, solved, index)
        value = marginal_at(problem, State(self.x, self.beta, self.noise, step.covariance), point, solved,
                            point.objective - step.fall)
        self.x = self.x.moved(step.latents)
        self.beta[index] += step.beta
        if not (np.isfinite(self.beta).all() and np.isfinite(self.x.q).all()):
            return _Evidence(-np.inf)
        if not (delays and problem.mechanism.actuated):
            return _Evidence(value, optimum=value, without=value)
        late = -float(self.beta[p])
        place = int(np.flatnonzero(index == p)[0])
        std = float(np.sqrt(step.covariance[place, place]))
        return _evidence(value, late, std, problem.dt)


def _evidence(value: float, late_s: float, std_s: float, dt_s: float) -> _Evidence:
    """Of a hold whose log-likelihood has its optimum, `value`, at a delay `late_s` with this standard deviation."""
    def integrated(prior_s: float) -> float:
        ratio = std_s**2 / (std_s**2 + prior_s**2)
        return value + 0.5 * np.log(ratio) - 0.5 * late_s**2 / (std_s**2 + prior_s**2)

    without, with_one = integrated(float(np.hypot(KNOWN * dt_s, KNOWN_S))), integrated(DELAY_S)
    return _Evidence(max(without, with_one), late_s if with_one > without else 0.0, value, std_s,
                     value - 0.5 * (late_s / std_s) ** 2)
