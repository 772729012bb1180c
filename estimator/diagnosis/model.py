"""`Model`: a fit of the train runs with any set of effects; its motion of any run, its noise, its scores of all others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from daq import BoolArray, FloatArray
from estimator.diagnosis.data_split import RunSplit
from estimator.diagnosis.decision_rule import DECIDING_S
from estimator.effects import Effect
from estimator.errors import FitError
from estimator.fitting import (
    Policies,
    converge_motion,
    descend,
    free_mask,
    gentle_start,
    iterate,
    mistaken_torques,
    start_motion,
    start_state,
)
from estimator.likelihood import Candidate, LatentProblem, Latents, Noise, State, log_marginal
from estimator.model import Mechanism
from estimator.parallel import parallel_map
from estimator.prediction import (
    SHORT_S,
    FittedModel,
    PredictedRun,
    SmoothedRun,
    predict_run,
    smooth_under,
)
from estimator.score import Score, score_at, total
from estimator.signals import SignalSet

T = TypeVar("T")
SMOOTHING_STEPS = 12
"""Most steps for the friction smoothing velocities, from the end of a fit."""


@dataclass(frozen=True)
class Model:
    """A fitted set of effects (none: the nominal model) on the train runs of a split."""

    split: RunSplit
    state: State
    problem: LatentProblem
    made: dict[str, Any] = field(default_factory=dict, init=False, repr=False, compare=False)
    """See `once`"""

    def once(self, what: str, make: Callable[[], T]) -> T:
        """Result of `make`, which `what` names; made once for this model."""
        if what not in self.made:
            self.made[what] = make()
        found: T = self.made[what]
        return found

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All effects that were fitted."""
        return self.problem.effects

    @cached_property
    def log_marginal(self) -> float:
        """See `likelihood.log_marginal`, under the model's own noise levels; -inf where it has no solution."""
        try:
            return log_marginal(self.problem, self.state)
        except np.linalg.LinAlgError:
            return -np.inf

    @property
    def fitted(self) -> FittedModel:
        """The leg's model."""
        split, state = self.split, self.state
        return FittedModel(split.mechanism, split.options.hold, state.beta, self.effects, state.covariance,
                           state.noise.levels(), self.problem.stage.angle_range, split.gear_ratio)

    def sizes(self) -> list[FloatArray]:
        """One size vector an effect."""
        return self.problem.split(self.state.beta)[1]

    def taken_of(self, effect: Effect) -> FloatArray:
        """(count,) what is taken off the readings as a small fault of this effect."""
        size = self.split.taken.get(effect.key, np.zeros(len(effect.sizes)))
        return np.append(size, np.zeros(len(effect.shapes)))

    def whole_sizes(self) -> list[FloatArray]:
        """One size vector an effect, with what is taken off the readings."""
        return [size + self.taken_of(effect) for effect, size in zip(self.effects, self.sizes())]

    def on(self, run: int, candidates: Sequence[Candidate] = (), signals: Sequence[SignalSet] | None = None
           ) -> LatentProblem:
        """Likelihood of one run, or of a replicate of it in `signals`, with the model's effects."""
        return self.split.problem([run], self.problem.stage.angle_range, self.effects, candidates, signals)

    def places(self) -> list[slice]:
        """Slices of the parameter vector with the sizes of each effect."""
        return self.problem.places()

    def std(self) -> FloatArray:
        """Standard deviations of the whole parameter vector, white noise taken for granted."""
        return np.sqrt(np.maximum(np.diag(self.state.covariance), 0.0))


def nominal_model(split: RunSplit, near: State | None = None) -> Model:
    """Nominal fit of the train runs, or that `near` it if it has their samples. Raises `FitError`.

    One that has converged is taken as it is. If the model takes the torque for noise, or does not converge, the fit
    starts again from slow motion. If that fails too, beta is least squares on filtered motion, with infinite variances;
    only motion and noise levels are estimated.
    """
    signals = split.signals(split.train)
    free, beta = free_mask(split.mechanism, split.options)
    held = np.zeros_like(free)
    blank = split.problem(split.train, np.zeros((split.mechanism.n, 2)))
    ways: list[tuple[Callable[..., State], BoolArray]] = [
        (start_state, free), (gentle_start, free), (start_state, held)]
    if near is not None and len(near.x.q) == blank.total:
        ways[0] = lambda *_: near, free
    for start, freed in ways:
        state = start(blank, signals, split.mechanism, split.options, free, beta)
        floors = split.floors(blank, state.beta)
        try:
            if not state.converged:  # `near` may have
                state = iterate(blank, state, freed, split.options, floors)
        except FitError:
            continue
        if state.converged and not mistaken_torques(blank, state, floors):
            break
    rest = blank.stiction(state.noise)
    if not np.isfinite(state.beta).all() or rest is None or not np.isfinite(state.x.q).all():
        raise FitError("the nominal fit does not converge, so its residual cannot be tested")
    split = split.with_stiction({i: rest[here] for i, here in split.parts})
    state = converge_motion(blank.with_stiction(rest), replace(state, noise=state.noise.levels()))
    if freed is held:
        state.covariance[free, free] = np.inf
    angle_range = np.stack([state.x.q.min(axis=0), state.x.q.max(axis=0)], axis=-1)
    model = Model(split, state, split.problem(split.train, angle_range))
    return replace(model, split=split.with_stiction(stiction_of_test(model)))


def nearby(model: Model) -> State:
    """State from which a nominal fit of other readings of the same samples begins."""
    state = model.state
    return replace(state, beta=state.beta[: model.problem.mechanism.p], noise=state.noise.levels(), converged=False)


def stiction_of_test(model: Model) -> dict[int, FloatArray]:
    """Test run to `Noise.stiction` as the model has it, of runs of which it is not known; without those that it
    cannot be fitted to."""
    unknown = [run for run in model.split.test if run not in model.split.stiction]

    def found(k: int) -> FloatArray | None:
        try:
            one = smooth(model, unknown[k])
        except FitError:
            return None
        return one.problem.stiction(one.state.noise)

    parts = parallel_map(found, len(unknown), model.split.workers)
    return {run: part for run, part in zip(unknown, parts) if part is not None}


def begin_afresh(nominal: Model) -> Model:
    """`nominal` with motion, beta and noise levels as a fit would start from them."""
    split = nominal.split
    return replace(nominal, state=gentle_start(nominal.problem, split.signals(split.train), split.mechanism,
                                               split.options, *free_mask(split.mechanism, split.options)))


def refit(start: Model, effects: Sequence[tuple[Effect, FloatArray]], limit: int = 30, noise: Noise | None = None,
          hold_shapes: bool = False, hold_limits: bool = True) -> Model:
    """Full non-linear fit of `start`'s runs with `effects` at their starting sizes; keeps `noise` if given.

    `hold_shapes` estimates the sizes alone; `hold_limits` fixes shapes that start at a limit of their range. Where the
    nominal fit did not converge, beta stays at least squares for effects with which it does not either. Raises
    `FitError`.
    """
    split = start.split
    problem = split.problem(split.train, start.problem.stage.angle_range, [e for e, _ in effects])
    p = split.mechanism.p
    parameters = np.concatenate([start.state.beta[:p], *[s for _, s in effects]])
    x = start.state.x
    state = State(Latents(x.q.copy(), x.v.copy(), x.u.copy()), parameters, noise or start.state.noise,
                  np.zeros((parameters.size, parameters.size)))
    free = np.ones(parameters.size, bool)
    free[:p] = free_mask(split.mechanism, split.options)[0]
    for (effect, size), place in zip(effects, problem.places()):
        held = np.array([hold_shapes or s.discrete for s in effect.shapes], dtype=bool)
        free[place.stop - len(effect.shapes) : place.stop] = ~(held | effect.at_limits(size) if hold_limits else held)
    floors = None if noise is not None else split.floors(problem, state.beta[:p])
    begin, held, unknown = state, free.copy(), np.isinf(start.state.covariance[:p, :p]).any()
    held[:p] = False
    state = iterate(problem, begin, free, split.options, floors, limit)
    if floors is not None and mistaken_torques(problem, state, floors):
        if not unknown or not held.any():
            raise FitError("the fit takes the torque for noise")
        state = iterate(problem, begin, held, split.options, floors, limit)
        state.covariance[:p, :p][np.ix_(free[:p], free[:p])] = np.inf
    return Model(split, converge_runs(split, problem, state), problem)


def converge_runs(split: RunSplit, problem: LatentProblem, state: State) -> State:
    """`state` with the likeliest motion of each train run, sought by steps of its own: a run in which a joint
    reverses close to a sample shortens no other run's steps. Raises `FitError`."""
    if problem.stiction(state.noise) is None:
        return converge_motion(problem, state)
    found = []
    for i, here in split.parts:
        own = split.problem([i], problem.stage.angle_range, problem.effects)
        found.append(converge_motion(own, replace(state, x=state.x.of(here), noise=state.noise.at(here))).x)
    q, v, u = (np.concatenate([getattr(x, name) for x in found]) for name in ("q", "v", "u"))
    return replace(state, x=Latents(q, v, u))


def likeliest_smoothing_velocity(model: Model, stated: Mechanism) -> Mechanism:
    """`stated` with the friction smoothing velocities estimated on the train runs together with `model`'s effects.

    Without the effects a larger smoothing velocity absorbs part of them. Raises `FitError`.
    """
    split = replace(model.split, mechanism=stated, stiction={})
    problem = split.problem(split.train, model.problem.stage.angle_range, model.effects)
    state = model.state
    free = np.ones(state.beta.size, bool)
    free[: stated.p] = free_mask(stated, split.options)[0]
    floors = split.floors(problem, state.beta[: stated.p])
    found = descend(problem, state, free, Policies.of(split.options, floors, seeks_smoothing=True), SMOOTHING_STEPS)
    return problem.smoothed_over(found.smoothing).mechanism


def predicted_train(model: Model) -> tuple[PredictedRun, ...]:
    """Free runs over SHORT_S of each train run from the fitted motion."""
    split = model.split
    return tuple(predict_run([SmoothedRun(split.names[i], tuple(split.runs[i]), model.on(i), state)], [SHORT_S])
                 for i, state in zip(split.train, run_states(model)))


def predicted_left_out(model: Model, scores: Sequence[Score], fold: Sequence[int]) -> dict[int, PredictedRun]:
    """Free runs of the train runs in `fold` at the horizons `DECIDING_S`, with parameters that were not fitted to them.

    The infinitesimal jackknife (Giordano et al., AISTATS 2019): with s the sum of the other runs' `scores`, one a train
    run, and I the information of all, the parameters move by I^-1 s. What only the runs of the fold know hardly moves.
    Raises `FitError` where a motion diverges.
    """
    split, beta = model.split, model.state.beta.copy()
    free = np.flatnonzero(np.diag(model.state.covariance) > 0.0)
    others = [s.score[free] for s, run in zip(scores, split.train) if run not in fold]
    if others and free.size:
        beta[free] += total([s.of(free) for s in scores]).covariance() @ np.sum(others, axis=0)
    moved = replace(model, state=replace(model.state, beta=beta))
    return {run: predict_run([smooth(moved, run)], DECIDING_S) for run in fold}


def gain_over(smaller: Model, model: Model) -> float:
    """Twice the log likelihood by which `model` is likelier than a `smaller` one of the same runs."""
    return 2.0 * (model.log_marginal - smaller.log_marginal)


def log_marginal_by_run(model: Model) -> FloatArray:
    """(R,) `Model.log_marginal` of each train run alone."""
    split, angle_range = model.split, model.problem.stage.angle_range
    return np.array([replace(model, state=state, problem=split.problem([i], angle_range, model.effects)).log_marginal
                     for i, state in zip(split.train, run_states(model))])


def run_states(model: Model) -> list[State]:
    """The fit's state cut into runs."""
    return [replace(model.state, x=model.state.x.of(here)) for _, here in model.split.parts]


def smooth(model: Model, run: int, start: Latents | None = None, signals: Sequence[SignalSet] | None = None
           ) -> SmoothedRun:
    """Motion of a run, or of a replicate of it in `signals`, parameters and noise held; sought from `start`, of a train
    run by default from the model's own."""
    split = model.split
    own = list(split.runs[run]) if signals is None else list(signals)
    problem = model.on(run, signals=own)
    if start is None and run in split.train:
        start = run_states(model)[split.train.index(run)].x
    begin = start or start_motion(problem, own, split.mechanism, split.options)
    state = smooth_under(problem, replace(model.state, x=begin), near=start is not None)
    rest = problem.stiction(state.noise)
    return SmoothedRun(split.names[run], tuple(own), problem.with_stiction(rest),
                       replace(state, noise=state.noise.levels()))


def score_train(model: Model, candidates: Sequence[Candidate]) -> list[Score]:
    """Scores of `candidates` at `model`, one a train run."""
    split, states = model.split, run_states(model)

    def scored(k: int) -> Score:
        problem = model.on(split.train[k], candidates)
        return score_at(problem, states[k])

    return parallel_map(scored, len(states), split.workers)
