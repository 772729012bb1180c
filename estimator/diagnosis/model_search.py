"""`explain`: full re-fits of the best single effects, then pairs, then one triple; scores of their residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.diagnosis.candidate_fit import Start, effects_of, fit_candidates, fit_models, own_gain
from estimator.diagnosis.context import DiagnosisContext, Explanation, best_shapes, p_of, seated, simulates_best
from estimator.diagnosis.decision_rule import (
    ALPHA,
    COLLINEAR,
    FIRST_SINGLES,
    LEFT_AT_REST,
    MOST_GROWN,
    PAIRS,
    PARENTS,
    RESIDUAL_SHARE,
    RIVAL,
    SCATTERED,
    SINGLES,
    STILL_LEFT,
    TRIPLES,
    WORTH_TRYING,
    ZERO_WITHIN,
)
from estimator.diagnosis.refit import Model, bootstrap_scores, score_discover, tests_of
from estimator.diagnosis.score_statistics import RunScore, ScoreTests, own_inflation
from estimator.effects import Effect
from estimator.errors import FitError

Progress = Callable[[str, float], None]


def explain(context: DiagnosisContext, tests: ScoreTests, singles: list[Explanation], say: Progress,
            promise: Callable[[Sequence[Explanation]], bool]) -> list[Explanation]:
    """Fitted explanations: `singles`, and more effects only if no single explains the error and more can be material.

    `promise` decides the latter. Then parts of the best explanation are exchanged.
    """
    if not singles or not promise(singles):
        return singles
    found = combine(context, singles, say, promise)
    adequate = [e for e in found if e.adequate]
    if not adequate:
        return found
    fewest = min(len(e.model.effects) for e in adequate)
    best = max((e for e in adequate if len(e.model.effects) == fewest), key=lambda e: e.gain)
    return found + swapped(context, tests, best, {keys_of(e) for e in found})


def swapped(context: DiagnosisContext, tests: ScoreTests, best: Explanation, known: set[frozenset[str]]
            ) -> list[Explanation]:
    """`best` with one effect after the other changed for each that it resembles, as far as not `known`."""
    model, out = best.model, []
    pairs = list(zip(model.effects, model.sizes()))
    shapes = best_shapes(context, tests)
    for k, effect in enumerate(model.effects):
        own = next(i for i in shapes if context.candidates[i].effect.key == effect.key)
        for i in shapes:
            other = context.candidates[i].effect
            start = [*pairs[:k], (other, start_size(context, tests, i)), *pairs[k + 1 :]]
            keys = frozenset(e.key for e, _ in start)
            if keys in known | context.given_up or len(keys) < len(start) or not resemble(context, tests, own, i):
                continue
            both = fit_candidates(context, [pairs, start])
            found = next((e for e in both if other.key in keys_of(e)), None)
            mine = next((e for e in both if keys_of(e) == keys_of(best)), None)
            if found is not None and mine is not None:
                scatter = best.left.scatter
                more = (found.gain - mine.gain) / scatter  # both weighed under one noise, unlike `best`
                out.append(replace(assess_residual(context, found, best.bias, scatter), gain=best.gain + more,
                                   parent=best.parent if best.parent <= keys else frozenset(),
                                   gain_over_parent=best.gain_over_parent + more,
                                   by_run=best.by_run + found.by_run - mine.by_run))
    return out


def resemble(context: DiagnosisContext, tests: ScoreTests, i: int, k: int) -> bool:
    """Whether the effects of two candidates are of one `Effect.equivalence_class` at one joint, or nearly collinear."""
    one, other = context.candidates[i].effect, context.candidates[k].effect
    if one.equivalence_class and one.equivalence_class == other.equivalence_class:
        return None in (one.joint, other.joint) or one.joint == other.joint
    a, b = context.columns[i][0], context.columns[k][0]
    information = tests.information
    return bool(information[a, b] ** 2 > COLLINEAR**2 * information[a, a] * information[b, b] > 0.0)


def keys_of(explanation: Explanation) -> frozenset[str]:
    """Its effects."""
    return effects_of(explanation.model)


def fit_first(context: DiagnosisContext, tests: ScoreTests) -> list[Model]:
    """The two most promising effects, each fitted alone."""
    first = promising(context, tests, SINGLES)[:FIRST_SINGLES]
    return fit_models(context, [start_of(context, tests, i) for i in first])


def fit_singles(context: DiagnosisContext, tests: ScoreTests, first: Sequence[Model] = ()) -> list[Explanation]:
    """The most promising effects, each fitted alone, the likeliest first; the `first` of them are fitted."""
    # from where one step may lead nowhere
    far = best_shapes(context, tests) if context.excess_noise(context.nominal) else []
    effects = [context.candidates[i].effect for i in far]
    starts: list[Start] = [[(e, np.array(size))] for e in effects for size in e.starts]
    known = {e.key for e in effects if e.starts}
    starts += [start_of(context, tests, i) for i in promising(context, tests, SINGLES)[FIRST_SINGLES:]
               if context.candidates[i].effect.key not in known]
    return fit_candidates(context, starts, first)


def fit_others(context: DiagnosisContext, tests: ScoreTests, singles: Sequence[Explanation]) -> list[Explanation]:
    """`singles` and every effect of the library that was not tried, each fitted alone, the likeliest first.

    Where no single closes, a nominal fit that is far wrong may have hidden the one cause that there is.
    """
    tried = {keys_of(e) for e in singles} | context.given_up
    starts = [start_of(context, tests, i) for i in best_shapes(context, tests)
              if frozenset({context.candidates[i].effect.key}) not in tried]
    return fit_candidates(context, starts, [e.model for e in singles])


def start_of(context: DiagnosisContext, tests: ScoreTests, i: int) -> Start:
    """Start of a fit with candidate i alone."""
    return [(context.candidates[i].effect, start_size(context, tests, i))]


def combine(context: DiagnosisContext, singles: Sequence[Explanation], say: Progress,
            promise: Callable[[Sequence[Explanation]], bool]) -> list[Explanation]:
    """`singles`; if none explains the error, pairs; if no pair does, and they `promise` more, one triple.

    A single's residual is a difference of form or a second cause. A pair with almost no residual is preferred.
    """
    singles = closing(context, singles)
    if any(s.adequate for s in singles):
        best = max((s for s in singles if s.adequate), key=lambda s: s.gain)
        if best.no_residual_effect:
            return singles
        say("trying pairs", 0.7)
        more = [p for p in forward_step(context, [best], PAIRS)
                if keys_of(best) < keys_of(p) and not same_family(best, p)]
        pairs = [p for p in more if p.adequate and (
            p.no_residual_effect or context.gain(p.left, p.best_left) < STILL_LEFT * p.gain_over_parent)]
        others = [replace(p, adequate=False) for p in more if not any(p is k for k in pairs)]
        return [*pairs, *others, *([replace(s, adequate=False) for s in singles] if pairs else singles)]
    say("trying pairs", 0.7)
    pairs = forward_step(context, seated(singles, PARENTS), PAIRS)
    pairs += backward_step(context, pairs)
    if any(s.adequate for s in pairs) or not pairs or not promise(pairs + singles):
        return pairs + singles
    say("trying three", 0.8)
    return forward_step(context, pairs[:1], TRIPLES) + pairs + singles


def closing(context: DiagnosisContext, singles: Sequence[Explanation]) -> list[Explanation]:
    """`singles`, of which those do not close that are far less likely than another, each under its own noise:
    what gains little leaves little, and would be all that pairs are grown from.
    """
    gains = [own_gain(context, s.model) for s in singles]
    least = (1.0 - STILL_LEFT) * max(gains, default=0.0)
    return [s if gain >= least else replace(s, adequate=False) for s, gain in zip(singles, gains)]


def backward_step(context: DiagnosisContext, explanation: Sequence[Explanation]) -> list[Explanation]:
    """Explanations with a small residual and an effect that is not significant, re-fitted without that effect.

    Only those that still explain the error. A nominal fit that is far wrong can hide the only cause at first.
    """
    starts = {}
    for e in explanation:
        there = presence(e.model, float(np.sqrt(e.left.scatter)))
        little = e.no_residual_effect or context.gain(e.left, e.best_left) < RESIDUAL_SHARE * e.gain
        rest = [pair for pair, real in zip(zip(e.model.effects, e.model.sizes()), there) if real]
        grown = e.parent == {effect.key for effect, _ in rest} and e.gain_over_parent < RESIDUAL_SHARE * e.gain
        if little and rest and not all(there) and not grown:  # what it was grown from is fitted as well already
            starts[keys_of(e)] = rest
    return [e for e in assess_residuals(context, fit_candidates(context, list(starts.values()))) if e.adequate]


def promising(context: DiagnosisContext, tests: ScoreTests, most: int, skip: Sequence[str] = ()) -> list[int]:
    """Candidates worth a re-fit, each effect in its best shape: the best by gain, and by gain over the common scatter
    instead of their own."""
    order = best_shapes(context, tests, skip)
    chance = {i: p_of(context, tests, i) for i in order}
    best = [i for i in order[:most] if chance[i] < WORTH_TRYING]
    common = {i: context.gain(tests, i) * float(np.mean(tests.inflation[context.columns[i]])) / tests.scatter
              for i in order if i not in best and chance[i] < WORTH_TRYING}
    badly = sorted(common, key=lambda i: -common[i])[:SCATTERED]
    return [*best, *(i for i in badly if common[i] > context.material(context.split.discover))]


def same_family(best: Explanation, pair: Explanation) -> bool:
    """Whether what `pair` adds to `best` is of the family of one of its effects, at the same joint, or a delay that a
    law leaves out."""
    own = {(e.family, e.joint) for e in best.model.effects if e.family}
    lag_s = max(e.lag_s for e in best.model.effects)
    more = [(e, s) for e, s in zip(pair.model.effects, pair.model.sizes()) if e.key not in keys_of(best)]
    return any((e.family, e.joint) in own or 0.0 < abs(e.delay_s(s)) < lag_s for e, s in more)


def start_size(context: DiagnosisContext, tests: ScoreTests, i: int) -> FloatArray:
    """One-step sizes of candidate i, with its shape; zero for sizes that do not define it."""
    effect, shape = context.candidates[i].effect, context.candidates[i].shape
    size = np.zeros(len(effect.sizes))
    size[: effect.defining] = tests.size(context.columns[i][: effect.defining])
    if effect.positive:  # a bad nominal fit can mislead even the sign
        size[0] = abs(size[0])
    return np.concatenate([size, shape])


def assess_residuals(context: DiagnosisContext, explanation: Sequence[Explanation], bias: Sequence[RunScore] = ()
                     ) -> list[Explanation]:
    """Each with the scores of its residual, over the scatter of the most likely one, and with its `bias`.

    The bias is simulated where it is not given.
    """
    if not explanation:
        return []
    scores = score_discover(explanation[0].model, context.candidates)
    bias = bias or bootstrap_bias(context, explanation[0].model, scores)
    first = assess_residual(context, explanation[0], bias, None, scores)
    scatter = first.left.scatter
    best = simulates_best(explanation)
    rivals = [e for e in explanation[1:] if e.gain > RIVAL * explanation[0].gain or e is best]
    return [first, *(assess_residual(context, e, bias, scatter) for e in rivals)]


def bootstrap_bias(context: DiagnosisContext, model: Model, scores: Sequence[RunScore]) -> list[RunScore]:
    """Bias of the `scores` at `model`, without the entries of its own sizes; the nominal model's where it cannot run.

    Motion and noise of an explanation differ from the nominal fit's, and so does the bias.
    """
    try:
        found = bootstrap_scores(model, context.candidates, scores, context.rng)
    except FitError:
        return context.bias
    return [drop_size_entries(r, model) for r in found]


def drop_size_entries(score: RunScore, model: Model) -> RunScore:
    """Without the entries of the model's own sizes; `insert_size_entries` puts them back, as zeros."""
    own = np.arange(model.problem.mechanism.p, model.problem.parameter_count)
    return RunScore(np.delete(score.score, own), np.delete(np.delete(score.information, own, 0), own, 1))


def assess_residual(context: DiagnosisContext, explanation: Explanation, replicates: Sequence[RunScore],
                    scatter: float | None, scores: Sequence[RunScore] | None = None) -> Explanation:
    """Explanation with the scores of its residual on the discover runs, and its gain over the scatter (by default its
    own)."""
    model = explanation.model
    scores = scores or score_discover(model, context.candidates)
    left = tests_of(model, scores, [insert_size_entries(b, model) for b in replicates])
    own = {e.key for e in model.effects}
    gains = [context.gain(left, i) if c.effect.key not in own else 0.0 for i, c in enumerate(context.candidates)]
    best = int(np.argmax(gains))
    scatter = left.scatter if scatter is None else scatter
    gain = explanation.gain / scatter
    least = context.material(context.split.discover)
    detectable = [i for i, g in enumerate(gains) if g > least and p_of(context, left, i) < ALPHA]
    small = all(gains[i] < may_leave(model, context.candidates[i].effect) * gain for i in detectable)
    adequate = (gain > least and small and not context.excess_noise(model)
              and all(presence(model, float(np.sqrt(left.scatter)))))
    own_scatter = own_inflation(scores, np.diag(model.state.covariance) > 0.0, left.scatter)
    return replace(explanation, gain=gain, gain_over_parent=explanation.gain_over_parent / scatter, left=left,
                   best_left=best, adequate=adequate, no_residual_effect=not detectable,
                   bias=tuple(replicates), inflation=own_scatter)


def may_leave(model: Model, other: Effect) -> float:
    """Share of its gain that `model` may leave to another effect: forms differ, most of all near rest."""
    rubs = any(e.near_rest and e.joint == other.joint for e in model.effects)
    return LEFT_AT_REST if rubs and other.near_rest else RESIDUAL_SHARE


def presence(model: Model, spread: float) -> list[bool]:
    """For each effect, whether a defining size is significant, no size has an impossible sign, and shapes are in range.

    A gear of zero compliance with friction and inertia of its motor is no elastic gear.
    """
    out = []
    for k, (effect, size) in enumerate(zip(model.named, model.sizes())):
        counts = significant(model, k, spread)
        below = size[: effect.positive] < 0.0
        wrong = (below & counts[: effect.positive]).any() or (effect.strict and effect.at_limits(size).any())
        out.append(bool(counts[: effect.defining].any() and not wrong))
    return out


def significant(model: Model, which: int, spread: float | FloatArray) -> NDArray[np.bool_]:
    """For each size of one effect of `model`, whether it differs from zero by its standard deviation times `spread`.

    `spread` is one value, or one for each parameter.
    """
    std = (spread * model.std())[model.places()[which]]
    return np.asarray(np.abs(model.sizes()[which]) > ZERO_WITHIN * std)[: len(model.effects[which].sizes)]


def insert_size_entries(score: RunScore, model: Model) -> RunScore:
    """The bias of a run of the nominal model as one of `model`, which has more parameters."""
    p = model.problem.mechanism.p
    return RunScore(np.insert(score.score, [p] * (model.problem.parameter_count - p), 0.0), score.information)


def forward_step(context: DiagnosisContext, parents: Sequence[Explanation], most: int) -> list[Explanation]:
    """Each parent with one more effect: those that its left-over scores best."""
    starts = []
    for parent in parents:
        begin = list(zip(parent.model.effects, parent.model.sizes()))
        for i in promising(context, parent.left, max(1, most // len(parents)), [e.key for e in parent.model.effects]):
            starts.append([*begin, (context.candidates[i].effect, start_size(context, parent.left, i))])
    unique = {tuple(sorted(e.key for e, _ in s)): s for s in reversed(starts)}
    refitted = fit_candidates(context, list(unique.values()), [p.model for p in parents])
    gains = {keys_of(e): e.gain for e in refitted}
    grown = []
    for e in refitted:
        smaller = next((keys_of(p) for p in parents if keys_of(p) < keys_of(e)), None)
        if smaller is not None:
            grown.append(replace(e, parent=smaller, gain_over_parent=e.gain - gains.get(smaller, 0.0)))
    bias = parents[0].bias if parents[0].adequate else ()  # what little its effect leaves hardly changes noise levels
    return assess_residuals(context, seated(grown, MOST_GROWN), bias)
