"""Score and information of every run at one reference model, over its parameters and every effect of the library."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq import Dataset, FloatArray
from estimator.effects import Effect, EncoderOffset, battery, library
from estimator.errors import FitError
from estimator.fitting import between_samples, free_mask, iterate, noise_floors, start_state
from estimator.likelihood import Candidate, LatentProblem, Noise, Stage, State
from estimator.model import Mechanism
from estimator.numerics import eliminate
from estimator.options import FitOptions
from estimator.prediction import smooth_under
from estimator.signals import SignalSet, split_signals

HIDDEN = 1e-6
"""Share of a column's information below which nothing is left of it."""


@dataclass(frozen=True)
class ReferenceFit:
    """The nominal model of the reference runs."""

    mechanism: Mechanism
    options: FitOptions
    beta: FloatArray
    """(p,)"""
    free: NDArray[np.bool_]
    """(p,)"""
    noise: Noise
    angle_range: FloatArray
    """(n, 2)"""
    gear_ratio: float
    candidates: tuple[Candidate, ...]
    """Of the library, then generic terms."""
    named: int
    """The first so many candidates are of the library."""
    refused: dict[str, str]

    @property
    def columns(self) -> tuple[str, ...]:
        """(m,) names of a score's columns: parameters, then every size of every candidate."""
        return (*self.mechanism.names, *(f"{c.effect.key} {size.name} {list(c.shape)}" for c in self.candidates
                                         for size in c.effect.sizes))

    @property
    def loose(self) -> list[int]:
        """Columns of encoders' zeros that differ from run to run."""
        every = [candidate.effect for candidate in self.candidates for _ in range(candidate.width)]
        return [k for k, effect in enumerate(every, self.mechanism.p)
                if isinstance(effect, EncoderOffset) and effect.joint in self.options.encoder_zeros]


@dataclass(frozen=True)
class Score:
    """Score and information over all columns, as the quadratic that the log likelihood is near a model; of a run at
    the reference model, its motion eliminated: parameters first, then candidates."""

    score: FloatArray
    """(m,)"""
    information: FloatArray
    """(m, m)"""

    def along(self, basis: FloatArray) -> Score:
        """Score of the k sizes that move all columns by `basis` (m, k) each."""
        return Score(basis.T @ self.score, basis.T @ self.information @ basis)

    def gain(self) -> float:
        """Fall of -2 log likelihood by the likeliest size of all columns."""
        return float(self.size() @ self.score)

    def predicted_gain(self, others: Score) -> float:
        """Fall of -2 log predictive density by sizes that `others` give, with their uncertainty; no change has zero.

        With J and r the information and score of `others`, I and s those of this one:
        (r + s)^T (J + I)^-1 (r + s) - r^T J^-1 r + log(|J| / |J + I|).
        """
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self.information) + np.diag(others.information), 1e-300))
        known = others.information * np.outer(scale, scale) + HIDDEN * np.eye(scale.size)
        both = known + self.information * np.outer(scale, scale)
        r, every = scale * others.score, scale * (others.score + self.score)
        return float(every @ np.linalg.solve(both, every) - r @ np.linalg.solve(known, r)
                     + np.linalg.slogdet(known)[1] - np.linalg.slogdet(both)[1])

    def without(self, basis: FloatArray) -> Score:
        """The same with the sizes along `basis` (m, k) fitted and projected out; columns of which nothing is left are
        zero."""
        carry = self.information @ basis @ self.along(basis).covariance()
        left = self.information - carry @ basis.T @ self.information
        score = self.score - carry @ (basis.T @ self.score)
        gone = np.diag(left) < HIDDEN * np.diag(self.information)
        score[gone], left[gone], left[:, gone] = 0.0, 0.0, 0.0
        return Score(score, left)

    def size(self) -> FloatArray:
        """(m,) generalised least squares."""
        return np.asarray(self.covariance() @ self.score)

    @property
    def scale(self) -> FloatArray:
        """(m,) root of each column's own information."""
        return np.sqrt(np.maximum(np.diag(self.information), 1e-300))

    @property
    def correlation(self) -> FloatArray:
        """(m, m) information of columns in units of their own."""
        return np.asarray(self.information / np.outer(self.scale, self.scale))

    def covariance(self) -> FloatArray:
        """(m, m) of the sizes."""
        scale = self.scale
        square = np.outer(scale, scale)
        return np.asarray(np.linalg.pinv(self.information / square, HIDDEN, hermitian=True) / square)


def fit_reference(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, gear_ratio: float
                  ) -> ReferenceFit:
    """The model that all reference runs share. Raises `FitError` where the fit does not converge."""
    hold, mechanism = between_samples(datasets, mechanism, options)
    options = replace(options, hold=hold, smoothing_velocity="given")
    signals = split_signals(datasets, mechanism, options)
    problem = _problem(signals, mechanism, hold, np.zeros((mechanism.n, 2)), gear_ratio)
    free, beta = free_mask(mechanism, options)
    state = start_state(problem, signals, mechanism, options, free, beta)
    state = iterate(problem, state, free, options, noise_floors(problem, mechanism, state.beta))
    if not state.converged:
        raise FitError("the fit of the reference runs did not converge")
    reach = np.stack([state.x.q.min(axis=0), state.x.q.max(axis=0)], axis=-1)
    return known_reference(mechanism, options, state.beta, state.noise.levels(), reach, gear_ratio)


def known_reference(mechanism: Mechanism, options: FitOptions, beta: FloatArray, noise: Noise, angle_range: FloatArray,
                    gear_ratio: float) -> ReferenceFit:
    """A fit whose numbers are known, with every candidate that is tried together with it."""
    imu, encoders = options.sensors == "imu", options.encoders_of(mechanism.n)
    effects, refused = library(mechanism, imu, encoders)
    candidates = [Candidate(e, shape) for e in effects for shape in e.grid()]
    unnamed = [Candidate(e) for e in battery(mechanism, imu, encoders)]
    free, _ = free_mask(mechanism, options)
    return ReferenceFit(mechanism, options, beta, free, noise, angle_range, gear_ratio, (*candidates, *unnamed),
                        len(candidates), refused)


def noisiness(fit: ReferenceFit) -> float:
    """Sum of the log noise levels that a fit found."""
    n = fit.noise
    levels = np.concatenate([n.torque, n.encoder[np.isfinite(n.encoder)], n.gyro, n.accel.ravel()])
    return float(np.log(np.maximum(levels, 1e-300)).sum())


def score_run(fit: ReferenceFit, data: Dataset, noise: Noise | None = None, shift: FloatArray | None = None
              ) -> Score:
    """At the likeliest motion of the run under the reference model and its noise, or another.

    With a `shift` (m,) of all columns it is taken at the changed model, to which a large change is closer, and carried
    back: score + information shift. `ReferenceFit.loose` columns are unknown in the run. Raises `FitError`."""
    m, options = fit.mechanism, fit.options
    moved = np.zeros(len(fit.columns)) if shift is None else shift
    present, sizes = _present(fit, moved)
    signals = split_signals([data], m, options)
    problem = _problem(signals, m, options.hold, fit.angle_range, fit.gear_ratio, effects=present)
    begin = start_state(problem, signals, m, options, np.zeros(m.p, dtype=bool), fit.beta)
    beta = np.concatenate([fit.beta + moved[: m.p], *sizes])
    state = smooth_under(problem, State(begin.x, beta, noise or fit.noise, np.zeros((beta.size, beta.size))))
    wide = _problem(signals, m, options.hold, fit.angle_range, fit.gear_ratio, fit.candidates, present)
    point = wide.linearise(state.x, state.beta, state.noise)
    product = eliminate(point.chain).product()
    own = np.r_[: m.p, beta.size : len(point.gradient_beta)]
    score = (product[1:, 0] - point.gradient_beta)[own]
    information = (point.corner - product[1:, 1:])[np.ix_(own, own)]
    if not (np.isfinite(score).all() and np.isfinite(information).all()):
        raise FitError(f"{data.name}: the reference model cannot follow this run")
    return Score(score + information @ moved, information).without(np.eye(moved.size)[:, fit.loose])


def _present(fit: ReferenceFit, shift: FloatArray) -> tuple[list[Effect], list[FloatArray]]:
    """Effects that a shift holds, and their sizes and shapes."""
    effects, sizes, start = [], [], fit.mechanism.p
    for candidate in fit.candidates:
        own = shift[start : start + candidate.width]
        if own.any():
            effects.append(candidate.effect)
            sizes.append(np.concatenate([own, candidate.shape]))
        start += candidate.width
    return effects, sizes


def _problem(signals: Sequence[SignalSet], mechanism: Mechanism, hold: str, angle_range: FloatArray,
             gear_ratio: float, candidates: Sequence[Candidate] = (), effects: Sequence[Effect] = ()
             ) -> LatentProblem:
    begin = tuple(float(s.time_s[0] - signals[0].time_s[0]) for s in signals)
    stage = Stage((0,) * len(begin), begin, begin, angle_range, gear_ratio)
    return LatentProblem(signals, mechanism, hold, stage, effects, candidates)
