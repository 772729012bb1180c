"""`fit_candidates`: full re-fits of sets of effects, the hopeless given up on the way, weighed under one noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from daq import FloatArray
from estimator.diagnosis.context import DiagnosisContext, Explanation
from estimator.diagnosis.decision_rule import COMPARED, HOPELESS
from estimator.diagnosis.refit import Model, deviance, misfit, misfit_by_run, refit, short_errors
from estimator.diagnosis.score_statistics import ScoreTests
from estimator.effects import Effect
from estimator.errors import FitError
from estimator.likelihood import State
from estimator.parallel import parallel_map

Start = list[tuple[Effect, FloatArray]]
"""Effects with the sizes at which a fit begins."""
HELD_STEPS, FREE_STEPS = 12, 24
"""Most steps of a re-fit with shapes held, and then with all free."""
COMPARE_STEPS = 25
"""... and of one under the noise levels of the best explanation."""
_NO_TESTS = ScoreTests(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), 1.0, np.zeros(0))


def fit_candidates(context: DiagnosisContext, starts: Sequence[Start], fits: Sequence[Model] = ()
                   ) -> list[Explanation]:
    """Fit every start, compare all and `fits` under the noise of the best, most likely first, each set of effects
    once."""
    return compare_fits(context, [*fits, *fit_models(context, starts, fits)], fits)


def fit_models(context: DiagnosisContext, starts: Sequence[Start], fits: Sequence[Model] = ()) -> list[Model]:
    """A model for every start that can be fitted and is not hopeless compared with the others and `fits`.

    Each is fitted with fixed shapes first, then with free ones.
    """
    held = hopeful(context, _fit_each(context, [list(s) for s in starts],
                                      lambda k: fit_held(context, starts[k])), fits)
    return hopeful(context, _fit_each(context, [list(zip(m.effects, m.sizes())) for m in held],
                                      lambda k: fit_free(context, held[k])), fits)


def hopeful(context: DiagnosisContext, models: Sequence[Model], fits: Sequence[Model]) -> list[Model]:
    """Those that gain a share of what the best of them and of `fits` gains."""
    gains = [own_gain(context, m) for m in models]
    best = max([*gains, *(own_gain(context, m) for m in fits)], default=0.0)
    kept = [gain >= min(best, HOPELESS * best) for gain in gains]
    context.given_up.update(effects_of(m) for m, keep in zip(models, kept) if not keep)
    return [m for m, keep in zip(models, kept) if keep]


def _fit_each(context: DiagnosisContext, starts: Sequence[Start], fit: Callable[[int], Model | None]) -> list[Model]:
    """The models that `fit` makes of the `starts`, on as many processes as the diagnosis has."""
    split, angle_range = context.split, context.nominal.problem.stage.angle_range

    def fitted(k: int) -> State | None:
        model = fit(k)
        return None if model is None else model.state

    models = []
    for start, state in zip(starts, parallel_map(fitted, len(starts), split.workers)):
        if state is not None:
            effects = tuple(e for e, _ in start)
            models.append(Model(split, effects, state, split.problem(split.discover, angle_range, effects)))
    return models


def fit_held(context: DiagnosisContext, start: Start) -> Model | None:
    """Full re-fit with shapes held; None where it fails.

    A large effect spoils the nominal fit's motion: where a fit fails from there, it starts again from filtered motion.
    """
    for again in (False, True):
        try:
            return refit(context.afresh if again else context.nominal, start, HELD_STEPS,
                         hold_shapes=True)
        except (FitError, np.linalg.LinAlgError):
            continue
    return None


def fit_free(context: DiagnosisContext, held: Model) -> Model:
    """`held` with its shapes free, as far as it has any or has not come to its end; discrete ones the likeliest."""
    held = climb_discrete(context, held)
    if held.state.converged and not any(not s.discrete for e in held.effects for s in e.shapes):
        return held
    try:
        found = refit(held, list(zip(held.effects, held.sizes())), FREE_STEPS, hold_limits=False)
        if any(np.any(e.at_limits(s)) for e, s in zip(found.effects, found.sizes())):
            if not found.state.converged:
                found = refit(found, list(zip(found.effects, found.sizes())), FREE_STEPS)
            return min(found, held, key=deviance)  # a shape can diverge
        return found
    except (FitError, np.linalg.LinAlgError):
        return held


def climb_discrete(context: DiagnosisContext, model: Model) -> Model:
    """`model`, or one likelier whose discrete shapes are neighbours of its own in their grids, as far as that goes on.

    The score that chose them is that of the nominal motion, which lacks the effect.
    """
    tried: set[tuple[int, int, float]] = set()
    while True:
        pairs, likeliest = list(zip(model.effects, model.sizes())), model
        for k, (effect, size) in enumerate(pairs):
            for i, shape in enumerate(effect.shapes, len(effect.sizes)):
                if not shape.discrete:
                    continue
                grid = effect.tried(shape)
                at = int(np.argmin(np.abs(np.array(grid) - size[i])))
                tried.add((k, i, grid[at]))
                for near in sorted({*grid[max(0, at - 1) : at + 2]} - {v for n, m, v in tried if (n, m) == (k, i)}):
                    tried.add((k, i, near))
                    moved = np.where(np.arange(size.size) < len(effect.sizes), 0.0, size)
                    moved[i] = near
                    try:
                        found = refit(model, [*pairs[:k], (effect, moved), *pairs[k + 1 :]], HELD_STEPS,
                                      hold_shapes=True)
                    except (FitError, np.linalg.LinAlgError):
                        continue
                    likeliest = min(likeliest, found, key=deviance)
        if likeliest is model:
            return model
        model = likeliest


def compare_fits(context: DiagnosisContext, models: Sequence[Model], keep: Sequence[Model] = ()) -> list[Explanation]:
    """Explanations by their gain under the noise of the best: the likeliest of `models` under their own noise, and
    those to `keep` in any case."""
    if not models:
        return []
    noise = min((m.state.noise for m in models), key=lambda s: context.nominal.problem.log_volume(s))
    models = sorted(models, key=deviance)
    models = [*models[:COMPARED], *(m for m in models[COMPARED:] if any(m is f for f in keep))]
    every = [context.nominal, *models]

    def refitted(k: int) -> tuple[float, FloatArray, FloatArray] | None:
        m = every[k]
        try:
            again = refit(m, list(zip(m.effects, m.sizes())), COMPARE_STEPS, noise)
        except FitError:
            if k > 0:  # under the noise of the best one it has no fit at all
                return None
            # the nominal model may not converge under so little noise; its last step is used
            again = replace(m, state=replace(m.state, noise=noise))
        return misfit(again), misfit_by_run(again), short_errors(m)

    plain, *found = parallel_map(refitted, len(every), context.split.workers)
    assert plain is not None
    out = [Explanation(m, plain[0] - w[0], _NO_TESTS, -1, False, by_run=w[1],
                       error=_relative(w[2], plain[2])) for m, w in zip(models, found) if w is not None]
    out.sort(key=lambda e: -e.gain)
    first = {effects_of(e.model): i for i, e in reversed(list(enumerate(out)))}
    return [e for i, e in enumerate(out) if first[effects_of(e.model)] == i]


def _relative(squares: FloatArray, nominal: FloatArray) -> float:
    """rms of errors over the nominal model's, sensors alike; inf where both diverge."""
    return float(np.sqrt(np.mean(np.nan_to_num(squares / nominal, nan=np.inf, posinf=np.inf))))


def effects_of(model: Model) -> frozenset[str]:
    """Keys of its effects."""
    return frozenset(e.key for e in model.effects)


def own_gain(context: DiagnosisContext, model: Model) -> float:
    """Twice the log likelihood that `model` gains over the nominal one, each under its own noise."""
    return context.deviance - deviance(model)
