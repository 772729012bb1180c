"""`search`: sets of effects that may explain the error, by forward selection with deletion and exchange.

A set of n effects is one of the best sets of n - 1 with one more. Scores at the fit of the smaller set, its motion and
parameters projected out, give the shape and the first size of every further effect. The sets of the largest
predicted gains are fitted to the end, and of the others those that are the likeliest after a few steps: one ranking
fails where the smaller model is far off, the other where a fit begins with a wrong step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from daq import FloatArray
from estimator.diagnosis.context import (
    DiagnosisContext,
    Progress,
    Start,
    assess,
    assess_answers,
    best_shapes,
    start_size,
    without,
)
from estimator.diagnosis.decision_rule import EDGE, GROWN, MOST_EFFECTS, SUFFICES, WIDTH
from estimator.diagnosis.error_table import NOMINAL
from estimator.diagnosis.explanation import (
    Explanation,
    admissible,
    by_error,
    first_of_each,
    presence,
    seated,
    undetermined,
)
from estimator.diagnosis.loop_starts import by_loops_first, is_of_loop
from estimator.diagnosis.model import (
    Model,
    gain_over,
    log_marginal_by_run,
    predicted_train,
    refit,
)
from estimator.diagnosis.train_errors import train_table
from estimator.errors import FitError
from estimator.fit_errors import FIT_ERRORS
from estimator.likelihood import State
from estimator.parallel import parallel_map
from estimator.prediction import SHORT_S, PredictedRun, tabulate, together
from estimator.score import ScoreTests

FIRST_STEPS, HELD_STEPS = 2, 12
"""Most steps of a fit with shapes held: of those that are tried, and of those that are fitted to the end."""
FREE_STEPS = 24
"""Most steps of a fit with all shapes free."""
COMPARE_STEPS = 25
"""... and of one under the noise levels of the best explanation."""


class Promise(NamedTuple):
    """Whether further sets of effects can be better, by the errors of free runs."""

    better: bool
    """Another set can be materially better: the least error leaves room for it above noise."""
    larger: bool
    """A set of more effects can be."""


def search(context: DiagnosisContext, tests: ScoreTests, say: Progress) -> list[Explanation]:
    """Explanations, the likeliest first, each set of effects once, weighed under the noise levels of the best.

    More sets of a size are tried while the errors `promise` that another can be materially better, and larger ones
    while one of the best leaves something detectable, too. No test run is looked at.
    """
    found: list[Explanation] = []
    parents = [Explanation(context.nominal, 0.0, tests)]
    for count in range(1, MOST_EFFECTS + 1):
        say(f"fitting sets of {count}", 0.3 + 0.15 * count)
        starts = by_loops_first(grown(context, parents), WIDTH) if count == 1 else grown(context, parents)
        width = WIDTH if count > 1 else WIDTH + sum(is_of_loop(start) for _, start in starts[WIDTH:])
        fits = fit_sets(context, starts[:width])
        best = assess_answers(context, fits)
        if not best or promise(context, [*found, *best]).better:  # noise can hide what a wrong effect leaves
            fits += fit_sets(context, tried(context, starts[width:]))
            best = assess_answers(context, without(fits, best), best)
        if not best:
            break
        parents = seated(best, WIDTH)
        found += [*best, *reduced(context, parents)]
        if count == MOST_EFFECTS or not any(e.has_residual for e in parents) or not promise(context, found).larger:
            break
        rest = assess(context, without(fits, best))  # a cause of several can be far from the likeliest single one
        parents = seated(sorted([*best, *rest], key=lambda e: -e.gain), WIDTH)
        found += [*rest, *reduced(context, [e for e in parents if any(e is r for r in rest)])]
    say("comparing the best sets", 0.8)
    found = possible(found)
    return weigh(context, possible(found + exchanged(context, tests, found)))


def promise(context: DiagnosisContext, found: Sequence[Explanation]) -> Promise:
    """Whether other sets of effects, and larger ones, than those `found` can be materially better, by the train runs.

    The least error must leave room for that above the noise floor. For larger sets the last effect must have reduced
    the error by a good part of the material amount; a second effect is tried without that, too, where the error is
    larger than a disturbance explains.
    """
    best = by_error(first_of_each(found))
    try:
        table = train_table(context, best)
    except FitError:
        return Promise(True, True)
    counts = np.array([0, *(len(e.model.effects) for e in best)])
    errors = np.array([table.error(k) for k in range(len(counts))])
    last, before = errors[counts == counts.max()].min(), errors[counts < counts.max()].min()
    least = min(last, before)
    better = bool(least * (1.0 - context.share) > 1.0)
    return Promise(better, better and bool((counts.max() == 1 and least > EDGE)
                                           or last < before * (1.0 - SUFFICES * context.share)))


def possible(explanations: Sequence[Explanation]) -> list[Explanation]:
    """The `admissible` ones, or all without any: a set that is no answer sets neither noise levels nor scatter."""
    return [e for e in explanations if admissible(e)] or list(explanations)


def grown(context: DiagnosisContext, parents: Sequence[Explanation]) -> list[tuple[Model, Start]]:
    """Each of `parents` with one more effect in its best shape, by falling gain as the scores predict it, each set of
    effects once: all effects for the nominal model, for others those of the largest gains. Then the nominal model with
    the further sizes from which an effect's fit may begin."""
    scored: list[tuple[float, Model, Start]] = []
    more: list[tuple[Model, Start]] = []
    for parent in parents:
        begin = pairs_of(parent.model)
        order = best_shapes(context, parent.left, [e.key for e in parent.model.effects])
        for i in order[: GROWN if begin else None]:
            effect, scatter = context.candidates[i].effect, parent.left.scatter
            gain = parent.gain + scatter * context.gain(parent.left, i)
            scored.append((gain, parent.model, [*begin, (effect, start_size(context, parent.left, i))]))
            if not begin:
                more += [(parent.model, [(effect, np.array(size))]) for size in effect.starts]
    scored.sort(key=lambda one: -one[0])
    first: dict[frozenset[str], tuple[Model, Start]] = {}
    for _, model, start in scored:
        first.setdefault(frozenset(e.key for e, _ in start), (model, start))
    return [*first.values(), *more]


def tried(context: DiagnosisContext, starts: Sequence[tuple[Model, Start]]) -> list[tuple[Model, Start]]:
    """The sets of `starts` that are the likeliest after a few steps, up to WIDTH, from there."""
    begun = _each(context, [s for _, s in starts], lambda k: fit_held(context, *starts[k], FIRST_STEPS))
    found = sorted((m for m in begun if m is not None), key=lambda m: -m.log_marginal)
    return [(m, pairs_of(m)) for m in unlike(found)[:WIDTH]]


def fit_sets(context: DiagnosisContext, starts: Sequence[tuple[Model, Start]]) -> list[Explanation]:
    """The sets of `starts`, from a model and sizes each, fitted to the end, the likeliest first."""
    every = _each(context, [s for _, s in starts], lambda k: fit_whole(context, *starts[k]))
    fitted = {key_of(start): m for (_, start), m in zip(starts, every) if m is not None}
    context.whole.update(fitted)
    return explained(context, list(fitted.values()))


def explained(context: DiagnosisContext, models: Sequence[Model]) -> list[Explanation]:
    """Explanations by `models`, with the error of their free runs on the train runs; the likeliest first."""
    runs = parallel_map(lambda k: predicted_train(models[k]), len(models), context.split.workers)
    found = [Explanation(m, gain_over(context.nominal, m), error=relative_error(context.predicted, own))
             for m, own in zip(models, runs)]
    return sorted(found, key=lambda e: -e.gain)


def relative_error(nominal: Sequence[PredictedRun], runs: Sequence[PredictedRun]) -> float:
    """rms error of free runs over SHORT_S over the nominal model's, sensors alike; inf where both diverge."""
    table = tabulate([together(a, b) for a, b in zip(nominal, runs, strict=True)], NOMINAL, every_horizon=True)
    ratios = [np.divide(table.rms(1, c, SHORT_S), table.rms(NOMINAL, c, SHORT_S)) ** 2
              for c, read in zip(table.channels, table.read) if read]
    return float(np.sqrt(np.mean(np.nan_to_num(ratios, nan=np.inf, posinf=np.inf))))


def key_of(start: Start) -> bytes:
    """Key of a start of a fit: its effects and their sizes."""
    return b" ".join(effect.key.encode() + size.tobytes() for effect, size in start)


def unlike(models: Iterable[Model]) -> list[Model]:
    """The first model of each set of effects."""
    first: dict[frozenset[str], Model] = {}
    for model in models:
        first.setdefault(frozenset(e.key for e in model.effects), model)
    return list(first.values())


def pairs_of(model: Model) -> Start:
    """Its effects with their sizes."""
    return list(zip(model.effects, model.sizes()))


def _each(context: DiagnosisContext, starts: Sequence[Start], fit: Callable[[int], Model | None]
          ) -> list[Model | None]:
    """The model that `fit` makes of each of the `starts`, on as many processes as the diagnosis has."""
    split, angle_range = context.split, context.nominal.problem.stage.angle_range

    def fitted(k: int) -> tuple[State, float] | None:
        model = fit(k)
        return None if model is None else (model.state, model.log_marginal)

    def known(start: Start, state: State, value: float) -> Model:
        model = Model(split, state, split.problem(split.train, angle_range, [e for e, _ in start]))
        vars(model)["log_marginal"] = value
        return model

    return [None if found is None else known(start, *found)
            for start, found in zip(starts, parallel_map(fitted, len(starts), split.workers))]


def fit_held(context: DiagnosisContext, begin: Model, start: Start, steps: int) -> Model | None:
    """The model after so many `steps` of a fit from the motion of `begin`, shapes held; None where it fails.

    A large effect spoils the motion of a model without it: where a fit fails from there, it starts again from filtered
    motion.
    """
    for model in (begin, context.afresh):
        try:
            return refit(model, start, steps, hold_shapes=True)
        except FIT_ERRORS:
            continue
    return None


def fit_whole(context: DiagnosisContext, begin: Model, start: Start) -> Model | None:
    """A fit with shapes held, then free, as far as `context` has none from this start; None where it fails."""
    key = key_of(start)
    if key in context.whole:
        return context.whole[key]
    held = fit_held(context, begin, start, HELD_STEPS)
    return None if held is None else fit_free(held)


def fit_free(held: Model) -> Model:
    """`held` with its shapes free, as far as it has any or has not come to its end; discrete ones the likeliest."""
    held = climb_discrete(held)
    if held.state.converged and not any(not s.discrete for e in held.effects for s in e.shapes):
        return held
    try:
        model = refit(held, pairs_of(held), FREE_STEPS, hold_limits=False)
        if any(np.any(e.at_limits(s)) for e, s in zip(model.effects, model.sizes())):
            if not model.state.converged:
                model = refit(model, pairs_of(model), FREE_STEPS)
            return max(model, held, key=lambda m: m.log_marginal)  # a shape can diverge
        return model
    except FIT_ERRORS:
        return held


def climb_discrete(model: Model) -> Model:
    """`model`, or one likelier whose discrete shapes are neighbours of its own in their grids, as far as that goes on.

    The score that chose them is that of a motion that lacks the effect.
    """
    known: set[tuple[int, int, float]] = set()
    while True:
        pairs, likeliest = pairs_of(model), model
        for k, (effect, size) in enumerate(pairs):
            for i, shape in enumerate(effect.shapes, len(effect.sizes)):
                if not shape.discrete:
                    continue
                grid = effect.tried(shape)
                at = int(np.argmin(np.abs(np.array(grid) - size[i])))
                known.add((k, i, grid[at]))
                for near in sorted({*grid[max(0, at - 1) : at + 2]} - {v for n, m, v in known if (n, m) == (k, i)}):
                    known.add((k, i, near))
                    moved = np.where(np.arange(size.size) < len(effect.sizes), 0.0, size)
                    moved[i] = near
                    try:
                        found = refit(model, [*pairs[:k], (effect, moved), *pairs[k + 1 :]], HELD_STEPS,
                                      hold_shapes=True)
                    except FIT_ERRORS:
                        continue
                    likeliest = max(likeliest, found, key=lambda m: m.log_marginal)
        if likeliest is model:
            return model
        model = likeliest


def reduced(context: DiagnosisContext, explanations: Sequence[Explanation]) -> list[Explanation]:
    """Sets with an effect that is not significant, fitted without it, from the motion of the set.

    The nominal model's motion can be too far off for a fit of the only cause. Effects that replace each other in the
    set are left out in turn: with all of them none is determined, and without all of them the cause is missing.
    """
    starts: dict[frozenset[str], tuple[Model, Start]] = {}
    for e in explanations:
        there, open_effects = presence(e), undetermined(e)
        kept = [there, *([r or (t and i != k) for i, (r, t) in enumerate(zip(there, open_effects))]
                         for k, one in enumerate(open_effects) if one)]
        for which in kept:
            rest = [pair for pair, keep in zip(pairs_of(e.model), which) if keep]
            if rest and not all(which):
                starts.setdefault(frozenset(effect.key for effect, _ in rest), (e.model, rest))
    return assess(context, fit_sets(context, list(starts.values()))) if starts else []


def exchanged(context: DiagnosisContext, tests: ScoreTests, explanations: Sequence[Explanation]) -> list[Explanation]:
    """Sets that differ from the likeliest of each number of effects by one effect, changed for one that can replace it.

    Without those among the `explanations`, and of each number those alone that are the likeliest after a few steps.
    """
    known = {e.keys for e in explanations}
    shapes, chosen = best_shapes(context, tests), []
    for count in sorted({len(k) for k in known}):
        best = max((e for e in explanations if len(e.model.effects) == count), key=lambda e: e.gain)
        pairs, starts = pairs_of(best.model), []
        for k, effect in enumerate(best.model.effects):
            own = next(i for i in shapes if context.candidates[i].effect.key == effect.key)
            for i in shapes:
                other = context.candidates[i].effect
                keys = best.keys - {effect.key} | {other.key}
                if len(keys) == count and keys not in known and replaces(context, tests, i, own):
                    known.add(keys)
                    changed = [*pairs[:k], (other, start_size(context, tests, i)), *pairs[k + 1 :]]
                    starts.append((context.nominal, changed))
        chosen += tried(context, starts)
    return without(assess_answers(context, fit_sets(context, chosen), explanations), explanations) if chosen else []


def replaces(context: DiagnosisContext, tests: ScoreTests, other: int, own: int) -> bool:
    """Whether the effect of candidate `other` can stand for that of `own`.

    Both are of one `Effect.equivalence_class` at one joint, or the sizes of `other` explain more than SUFFICES of what
    the first size of `own` explains. An eccentric encoder has an offset, too, and the offset alone leaves little that
    free runs show.
    """
    one, two = context.candidates[own].effect, context.candidates[other].effect
    if one.equivalence_class and one.equivalence_class == two.equivalence_class:
        return None in (one.joint, two.joint) or one.joint == two.joint
    return tests.explained(context.columns[own][0], context.columns[other][: two.defining]) > SUFFICES


def weigh(context: DiagnosisContext, explanations: Sequence[Explanation]) -> list[Explanation]:
    """The likeliest fit of each set of effects, the most likely first.

    Its gain over the nominal model is that under the noise of the likeliest set, over the scatter between runs.
    """
    first: dict[frozenset[str], Explanation] = {}
    for e in sorted(explanations, key=lambda e: -e.gain):
        first.setdefault(e.keys, e)
    best = list(first.values())
    if not best:
        return []
    models = [context.nominal, *(e.model for e in best)]
    noise = best[0].model.state.noise

    def weighed(k: int) -> tuple[float, FloatArray] | None:
        m = models[k]
        try:
            again = refit(m, pairs_of(m), COMPARE_STEPS, noise)
        except FitError:
            if k > 0:  # under the noise of the best one it has no fit at all
                return None
            # the nominal model may not converge under so little noise; its last step is used
            again = replace(m, state=replace(m.state, noise=noise))
        return -2.0 * again.log_marginal, -2.0 * log_marginal_by_run(again)

    plain, *others = parallel_map(weighed, len(models), context.split.workers)
    assert plain is not None
    out = [replace(e, gain=(plain[0] - own[0]) / best[0].left.scatter, by_run=own[1])
           for e, own in zip(best, others) if own is not None]
    return sorted(out, key=lambda e: -e.gain)


def with_one_more(context: DiagnosisContext, best: Explanation) -> list[Explanation]:
    """Sets of `best` and one of the effects of the largest scores, each with its gain over `best`; the likeliest first.

    Empty where `best` leaves nothing detectable.
    """
    if not best.has_residual:
        return []
    fits = assess(context, fit_sets(context, grown(context, [best])[:WIDTH]))
    found = [replace(e, gain=gain_over(best.model, e.model) / best.left.scatter, by_run=np.zeros(0)) for e in fits]
    return sorted(found, key=lambda e: -e.gain)
