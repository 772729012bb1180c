"""`assess`: the scores of what sets of effects leave, for those that can be the answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import FloatArray
from estimator.diagnosis.context import DiagnosisContext, Explanation, detected, keys_of
from estimator.diagnosis.model_comparison import LEAST_APART
from estimator.diagnosis.presence import admissible
from estimator.diagnosis.refit import Model, bootstrap_scores, score_discover, tests_of
from estimator.errors import FitError
from estimator.score import NO_TESTS, Score, determined, own_inflation


def assess_answers(context: DiagnosisContext, sets: Sequence[Explanation], others: Sequence[Explanation] = ()
                   ) -> list[Explanation]:
    """Those of `sets` that can be an answer, assessed, with the assessed `others`; the likeliest first.

    A set is no answer where an admissible one of as many effects is likelier, whatever one further effect would change
    of that, and simulates better, too.
    """
    found = list(others)
    for e in sorted(sets, key=lambda e: -e.gain):
        if not any(outperforms(o, e) and admissible(o) for o in found):
            found += assess(context, [e])
    return sorted(found, key=lambda e: -e.gain)


def outperforms(one: Explanation, other: Explanation) -> bool:
    """Whether `one`, assessed, has as many effects as the `other`, a smaller error, and a larger gain beyond any tie:
    the `margin` of the other is at most the largest gain that one further effect adds to this one."""
    return (len(one.model.effects) == len(other.model.effects) and one.error < other.error
            and one.gain - other.gain > one.left.scatter * (one.further.max(initial=0.0) + LEAST_APART))


def without(sets: Sequence[Explanation], others: Sequence[Explanation]) -> list[Explanation]:
    """Those of `sets` whose models are not among those of the `others`."""
    return [e for e in sets if not any(e.model is o.model for o in others)]


def assess(context: DiagnosisContext, explanations: Sequence[Explanation]) -> list[Explanation]:
    """Each with the scores of what it leaves on the discover runs, less their bias; as it is where it has them."""
    new = [e.model for e in explanations if e.left is NO_TESTS]
    every = [score_discover(m, context.candidates) for m in new]
    biases = iter([bias_of(context, m, scores) for m, scores in zip(new, every)])
    own = iter(every)
    return [assessed(context, e, next(own), next(biases)) if e.left is NO_TESTS else e for e in explanations]


def bias_of(context: DiagnosisContext, model: Model, scores: Sequence[Score]) -> list[FloatArray]:
    """Bias of the `scores` of sets of as many effects as `model` has, one a discover run, own sizes left out.

    It is simulated for the first of them. Where it cannot be, it is that of the nominal model.
    """
    count = len(model.effects)
    if count not in context.biases:
        try:
            bias = bootstrap_scores(model, context.candidates, scores, context.rng)
        except FitError:
            return context.bias
        own = np.arange(model.problem.mechanism.p, model.problem.parameter_count)
        context.biases[count] = [np.delete(one, own) for one in bias]
    return context.biases[count]


def assessed(context: DiagnosisContext, explanation: Explanation, scores: Sequence[Score],
             bias: Sequence[FloatArray]) -> Explanation:
    """Explanation with its `scores` on the discover runs."""
    model = explanation.model
    p = model.problem.mechanism.p
    own = [p] * (model.problem.parameter_count - p)
    left = tests_of(model, scores, [np.insert(one, own, 0.0) for one in bias])
    free = np.diag(model.state.covariance) > 0.0
    keys = keys_of(explanation)
    further = np.array([0.0 if c.effect.key in keys else context.gain(left, i)
                        for i, c in enumerate(context.candidates)])
    return replace(explanation, left=left, has_residual=detected(context, left, keys), further=further,
                   inflation=own_inflation(scores, free, left.scatter), determined=determined(scores, free))
