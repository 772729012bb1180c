r"""`shoot`: parameters by output error over short segments, each from an initial state of its own (multiple shooting).

Every gap-free segment is cut into segments of about a second. The equation of motion, collocated as everywhere in
`estimator.model`, is integrated over each under the measured torque, and its readings y(t; beta, x_s) are held against
those of encoders, gyros and accelerometers. Minimised over beta and the initial states x_s is

    sum over s of rho( sum over channels c of  |y_c - y_c measured|^2 / sigma_c^2 )

The level sigma_c of a channel is that of its output error, not of its sensor: torque noise and what the model lacks,
integrated over a second, are in it. It is estimated, by iterated reweighting, and rho is the loss of Student's t, so a
segment in which something else happened counts little. (Bock, Recent advances in parameter identification techniques
for O.D.E., 1983; Ljung, System Identification, 1999, section 7.2.)

The steps are Gauss-Newton's. Sensitivities come from the variational equation of the collocated system, all parameters
and initial states at once, and the equation's own defect goes along as one more column: the first steps start from the
measured motion, not from a simulation (lifted Newton method: Albersmeyer and Diehl, SIAM J. Optim. 20, 2010). Initial
states are eliminated segment by segment (Schur complement). Cost is linear in samples.

`mle` fails where errors of the angles or of the torque are not white. This fails where a second's output error does not
show a parameter, and for torque noise that is large even after it is integrated twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from daq import BoolArray, FloatArray
from estimator.errors import FitError
from estimator.fitting.shooting_segments import Linear, Segments
from estimator.model import Mechanism
from estimator.numerics import pseudo_inverse
from estimator.result import TWO_SIDED
from estimator.score import robust_covariance
from estimator.signals import SignalSet, by_run

SEGMENT_S = 1.0
"""Length of a segment, about."""
FREEDOM = 3.0
"""Degrees of freedom of Student's t, of a segment's mean squared residual."""
STEPS, REWEIGHTINGS = 30, 3
"""Most Gauss-Newton steps, and reweightings in each."""
SMOOTH = 0.005
"""Least smoothing velocity of friction, as a share of the joint's root mean square speed. (Measured on a geared
pendulum: with the rig's own, steps go to and fro between sticking and sliding; values differ by 0.3 standard
deviations.)"""
STILL, NEARLY_STILL = 0.1, 0.5
"""Length of a step in standard deviations at which the search ends, and what counts as an end after `STEPS`: where a
joint turns round under dry friction the last steps go to and fro."""
ENOUGH_RUNS = 8
"""From so many runs on the covariance is clustered by runs, else by segments."""
TINY_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-9, 1e-3, 1e3
"""Share of its own diagonal that is added to the information: always, so that what the data does not show stays, and
where a step does not lower the loss."""
LEAST_STIFF, FREE_STEPS = 0.03, 2
"""The same for the initial state of a segment whose own misfit rose, after so many steps, which come from far off."""
SAME = 1e-3
"""Share by which the loss may rise: levels and weights change from step to step, and it with them."""
MOST_LOST = 0.5
"""Share of segments that may diverge."""
LOST = 100.0
"""Mean squared residual, in variances, that a segment counts with whose simulation diverges."""


@dataclass(frozen=True)
class Shot:
    """Result of multiple shooting."""

    beta: FloatArray
    """(p,)"""
    covariance: FloatArray
    """(p, p), robust against any dependence within a segment, or a run."""
    half_width: FloatArray
    """(p,) half of each 95 % interval, by Student's t."""
    levels: FloatArray
    """(C,) output error of each channel over a segment, in the channels' units."""
    iterations: int
    segments: int
    lost: int
    """Segments whose simulation diverges; they say nothing."""
    loss: float
    """-2 log-likelihood of Student's t, for comparison on the same data."""

    @property
    def spread(self) -> FloatArray:
        """(p, p) covariance whose normal 95 % intervals have `half_width`."""
        std = np.sqrt(np.diag(self.covariance))
        wider = np.where(std > 0.0, self.half_width / np.where(std > 0.0, TWO_SIDED * std, 1.0), 1.0)
        return self.covariance * np.outer(wider, wider)


class _Step(NamedTuple):
    parameters: FloatArray
    """(f,)"""
    states: FloatArray
    """(S, 2 n) of each segment's first sample"""
    levels: FloatArray
    """(C,)"""
    weights: FloatArray
    """(S,)"""
    information: FloatArray
    """(S, f, f) of each segment"""
    score: FloatArray
    """(S, f)"""


class _Point(NamedTuple):
    """Where a search stands."""

    beta: FloatArray
    q: FloatArray
    v: FloatArray
    """(N, n) a motion that obeys the equation, but in segments that are lost"""
    squares: FloatArray
    """(S, C) summed squared residuals"""
    lost: BoolArray
    """(S,) whose simulation diverges: their motion is the one measured, and they count with `LOST`."""


class _Search:
    """Gauss-Newton on one problem."""

    def __init__(self, segments: Segments, free: BoolArray, q: FloatArray, v: FloatArray) -> None:
        self.segments, self.free, self.home = segments, free, (q, v)
        self.floors, self.width = segments.floors(), int(free.sum())
        self.stiff = np.zeros(len(segments.first))
        """(S,) damping of each segment's initial state: where a joint turns round under dry friction steps go to and
        fro, and with them all parameters."""

    def weights(self, squares: FloatArray, levels: FloatArray) -> FloatArray:
        """(S,) of segments with summed squares (S, C): those of Student's t."""
        return (FREEDOM + 1.0) / (FREEDOM + self.misfit(squares, levels))

    def misfit(self, squares: FloatArray, levels: FloatArray) -> FloatArray:
        """(S,) mean squared residual of each segment, in variances."""
        return np.asarray((squares / levels**2).mean(axis=1) / self.segments.size)

    def loss(self, point: _Point, levels: FloatArray) -> float:
        """Sum of the t loss."""
        misfit = np.where(point.lost, LOST, np.minimum(self.misfit(point.squares, levels), LOST))
        return float(self.segments.size @ np.log1p(misfit / FREEDOM) * (FREEDOM + 1.0))

    def levels(self, squares: FloatArray, weights: FloatArray) -> FloatArray:
        """(C,) by weighted segments."""
        total = np.maximum(weights @ self.segments.size, 1e-300)
        return np.maximum(np.sqrt(weights @ squares / total), self.floors)

    def step(self, linear: Linear, levels: FloatArray, weights: FloatArray, damping: float) -> _Step:
        """At given levels and weights; initial states eliminated."""
        f = self.width
        normal = weights[:, None, None] * np.tensordot(levels**-2.0, linear.products, (0, 1))
        inverse = pseudo_inverse(normal[:, f:-1, f:-1], self.stiff)
        cross = normal[:, :f, f:-1] @ inverse
        information = normal[:, :f, :f] - cross @ normal[:, f:-1, :f]
        score = -(normal[:, :f, -1] - (cross @ normal[:, f:-1, -1:])[:, :, 0])
        parameters = pseudo_inverse(information.sum(axis=0), max(damping, TINY_DAMPING)) @ score.sum(axis=0)
        states = -(inverse @ (normal[:, f:-1, -1:] + normal[:, f:-1, :f] @ parameters[:, None]))[:, :, 0]
        return _Step(parameters, states, levels, weights, information, score)

    def reweighted(self, linear: Linear, before: _Step | None) -> _Step:
        """A step whose levels and weights are those of the residuals that it predicts."""
        levels, weights = (self.floors, np.ones(len(linear.products))) if before is None else before[2:4]
        step = self.step(linear, levels, weights, 0.0)
        for _ in range(REWEIGHTINGS):
            columns = self.columns(step)
            moved = (linear.products @ columns[:, None, :, None])[..., 0]
            squares = np.maximum(np.sum(moved * columns[:, None], axis=2), 0.0)
            levels = self.levels(squares, step.weights)
            step = self.step(linear, levels, self.weights(squares, levels), 0.0)
        return step

    def columns(self, step: _Step) -> FloatArray:
        """(S, m) by which a step moves each segment."""
        count = len(self.segments.first)
        return np.concatenate([np.broadcast_to(step.parameters, (count, self.width)), step.states,
                               np.ones((count, 1))], axis=1)

    def after(self, point: _Point, linear: Linear, step: _Step) -> _Point:
        """The step, simulated."""
        segments, beta = self.segments, point.beta.copy()
        beta[self.free] += step.parameters
        moved = np.repeat(self.columns(step), segments.size, axis=0)
        change = (linear.motion @ moved[:, :, None])[:, :, 0]
        with np.errstate(all="ignore"):
            q, v, good = segments.simulate(point.q + change[:, : segments.n], point.v + change[:, segments.n :], beta)
            squares = segments.squares(q, v)
        good &= np.isfinite(squares).all(axis=1)
        keep = np.repeat(good, segments.size)[:, None]
        return _Point(beta, np.where(keep, q, self.home[0]), np.where(keep, v, self.home[1]),
                      np.where(good[:, None], squares, 0.0), ~good)

    def run(self, beta: FloatArray) -> tuple[_Point, _Step, bool, int]:
        """Result of a search from `beta` (p,) and the measured motion: the end, the step that would be next, whether it
        is none, steps."""
        point = _Point(np.array(beta, dtype=np.float64), *self.home, np.zeros((0, 0)), np.zeros(0, bool))
        best, damping, share = np.inf, 0.0, 1.0
        linear, step = self.linearised(point, None)
        for taken in range(1, STEPS + 1):
            trial = self.after(point, linear, step)
            if taken > FREE_STEPS:
                worse = self.misfit(trial.squares, step.levels) > (1.0 + SAME) * self.misfit(point.squares, step.levels)
                self.stiff = np.where(worse, np.maximum(LEAST_STIFF, 10.0 * self.stiff), 0.5 * self.stiff)
            if self.loss(trial, step.levels) > best and damping < MOST_DAMPING:
                damping = 10.0 * damping if damping > 0.0 else LEAST_DAMPING
                step = self.step(linear, step.levels, step.weights, damping)
                continue
            point, damping, before = trial, damping / 10.0 if damping > LEAST_DAMPING else 0.0, step.parameters
            linear, step = self.linearised(point, step)
            whole = step.information.sum(axis=0)
            length = float(np.sqrt(np.maximum(step.parameters @ whole @ step.parameters, 0.0)))
            if length <= STILL or (taken == STEPS and length <= NEARLY_STILL):
                self.stiff = np.zeros_like(self.stiff)
                return point, self.step(linear, step.levels, step.weights, 0.0), True, taken
            best = self.loss(point, step.levels) * (1.0 + SAME)
            share = 0.5 * share if step.parameters @ whole @ before < 0.0 else min(1.0, 1.5 * share)
            step = self.step(linear, step.levels, step.weights, damping)
            step = step._replace(parameters=share * step.parameters)
        return point, step, False, STEPS

    def linearised(self, point: _Point, before: _Step | None) -> tuple[Linear, _Step]:
        """At a point, and the step from there."""
        linear = self.segments.linearise(point.q, point.v, point.beta, self.free)
        return linear, self.reweighted(linear, before)


def shoot(signals: Sequence[SignalSet], mechanism: Mechanism, hold: str, free: BoolArray,
          starts: Sequence[FloatArray], q: FloatArray, v: FloatArray) -> Shot:
    """Estimate the `free` (p,) parameters, from the measured or smoothed motion q, v (N, n).

    `starts` are values (p,) to begin with, the next where one leads nowhere. Raises `FitError` where none leads to an
    end.
    """
    speed = np.sqrt(np.mean(v**2, axis=0))
    smooth = np.maximum(mechanism.velocity_scales, SMOOTH * speed)
    segments = Segments(signals, replace(mechanism, velocity_scale=tuple(smooth.tolist())), hold, SEGMENT_S)
    search = _Search(segments, free, q, v)
    for beta in starts:
        try:
            with np.errstate(all="ignore"):  # a start that leads nowhere is found out by its loss
                point, step, converged, taken = search.run(beta)
        except np.linalg.LinAlgError:
            continue
        if converged and point.lost.mean() <= MOST_LOST:
            return _result(signals, search, point, step, taken)
    raise FitError(f"multiple shooting over {SEGMENT_S:g} s did not converge")


def _result(signals: Sequence[SignalSet], search: _Search, point: _Point, step: _Step, taken: int) -> Shot:
    segments, score, information = search.segments, step.score, step.information
    runs = by_run(signals)
    if len(runs) >= ENOUGH_RUNS:
        start = np.searchsorted(segments.first, [where.start for _, _, where in runs])
        score, information = np.add.reduceat(score, start), np.add.reduceat(information, start)
    p, index = len(point.beta), np.flatnonzero(search.free)
    covariance, half_width = np.zeros((p, p)), np.zeros(p)
    covariance[np.ix_(index, index)], quantile = robust_covariance(score, information)
    variance = np.diag(covariance)[index]  # below zero where few segments know of a direction
    half_width[index] = quantile * np.sqrt(np.where(variance >= 0.0, variance, np.nan))
    loss = segments.channels * search.loss(point, step.levels) + 2.0 * segments.data.total * np.log(step.levels).sum()
    return Shot(point.beta, covariance, half_width, step.levels, taken, len(point.lost), int(point.lost.sum()),
                float(loss))
