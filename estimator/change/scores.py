"""Score and information of every run at one reference model, over its parameters and every effect of the library."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq import BoolArray, Dataset, FloatArray
from estimator.effects import Effect, EncoderOffset, battery, library
from estimator.errors import FitError
from estimator.fitting import fit_nominal, free_mask, iterate, noise_floors, start_state
from estimator.free_runs import FittedModel
from estimator.likelihood import Candidate, Noise, State
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.prediction import smooth_under
from estimator.score import Score, score_at
from estimator.signals import split_signals


@dataclass(frozen=True)
class ReferenceFit:
    """The nominal model of the reference runs, and what is scored at it."""

    model: FittedModel
    options: FitOptions
    free: BoolArray
    """(p,) parameters that were estimated"""
    candidates: tuple[Candidate, ...]
    """Of the library, then generic terms."""
    named: int
    """The first so many candidates are of the library."""
    refused: dict[str, str]

    @property
    def noise(self) -> Noise:
        """Levels of the model, which a reference always has."""
        assert self.model.noise is not None
        return self.model.noise

    @property
    def columns(self) -> tuple[str, ...]:
        """(m,) names of a score's columns: parameters, then every size of every candidate."""
        return (*self.model.mechanism.names, *(f"{c.effect.key} {size.name} {list(c.shape)}" for c in self.candidates
                                         for size in c.effect.sizes))

    @property
    def loose(self) -> list[int]:
        """Columns of encoders' zeros that differ from run to run."""
        every = [candidate.effect for candidate in self.candidates for _ in range(candidate.width)]
        return [k for k, effect in enumerate(every, self.model.mechanism.p)
                if isinstance(effect, EncoderOffset) and effect.joint in self.options.encoder_zeros]


def fit_reference(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, gear_ratio: float
                  ) -> ReferenceFit:
    """The model that all reference runs share. Raises `FitError` where the fit does not converge."""
    hold, mechanism, state, *_ = fit_nominal(datasets, mechanism, options)
    if state is None:
        raise FitError("the fit of the reference runs did not converge")
    options = replace(options, hold=hold, smoothing_velocity="given")
    free, _ = free_mask(mechanism, options)
    blank = FittedModel(mechanism, hold, state.beta, gear_ratio=gear_ratio)
    problem = blank.problem(split_signals(datasets, mechanism, options))
    state = iterate(problem, state, free, options, noise_floors(problem, mechanism, state.beta))  # one level a channel
    if not state.converged:
        raise FitError("the fit of the reference runs did not converge")
    reach = np.stack([state.x.q.min(axis=0), state.x.q.max(axis=0)], axis=-1)
    found = replace(blank, parameters=state.beta, noise=state.noise.levels(), angle_range=reach)
    return known_reference(found, options)


def known_reference(model: FittedModel, options: FitOptions) -> ReferenceFit:
    """A fit whose numbers are known, its noise among them, with every candidate that is tried together with it."""
    mechanism = model.mechanism
    imu, encoders = options.sensors == "imu", options.encoders_of(mechanism.n)
    effects, refused = library(mechanism, imu, encoders)
    candidates = [Candidate(e, shape) for e in effects for shape in e.grid()]
    unnamed = [Candidate(e) for e in battery(mechanism, imu, encoders)]
    free, _ = free_mask(mechanism, options)
    return ReferenceFit(model, options, free, (*candidates, *unnamed), len(candidates), refused)


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
    model, m, options = fit.model, fit.model.mechanism, fit.options
    moved = np.zeros(len(fit.columns)) if shift is None else shift
    present, sizes = _present(fit, moved)
    signals = split_signals([data], m, options)
    changed = replace(model, parameters=np.concatenate([model.beta + moved[: m.p], *sizes]), effects=tuple(present))
    problem, beta = changed.problem(signals), changed.parameters
    begin = start_state(problem, signals, m, options, np.zeros(m.p, bool), model.beta)
    state = smooth_under(problem, State(begin.x, beta, noise or fit.noise, np.zeros((beta.size, beta.size))))
    found = score_at(changed.problem(signals, candidates=fit.candidates), state)
    found = found.of(np.r_[: m.p, beta.size : found.score.size])
    if not (np.isfinite(found.score).all() and np.isfinite(found.information).all()):
        raise FitError(f"{data.name}: the reference model cannot follow this run")
    found = replace(found, score=found.score + found.information @ moved)
    return found.without(np.eye(moved.size)[:, fit.loose])


def _present(fit: ReferenceFit, shift: FloatArray) -> tuple[list[Effect], list[FloatArray]]:
    """Effects that a shift holds, and their sizes and shapes."""
    effects, sizes, start = [], [], fit.model.mechanism.p
    for candidate in fit.candidates:
        own = shift[start : start + candidate.width]
        if own.any():
            effects.append(candidate.effect)
            sizes.append(np.concatenate([own, candidate.shape]))
        start += candidate.width
    return effects, sizes
