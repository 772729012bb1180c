"""One effect in addition to an answer: a sign of imitation, or a second cause that free runs hardly show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import FloatArray
from estimator.diagnosis.assessment import assess
from estimator.diagnosis.context import DiagnosisContext, Explanation
from estimator.diagnosis.decision_rule import SUFFICES, WIDTH
from estimator.diagnosis.model_comparison import is_close
from estimator.diagnosis.presence import admissible
from estimator.diagnosis.refit import Model, deviance, smooth
from estimator.diagnosis.search import fit_sets, grown
from estimator.errors import FitError


def with_one_more(context: DiagnosisContext, best: Explanation) -> list[Explanation]:
    """Sets of `best` and one of the effects of the largest scores, each with its gain over `best`; the likeliest first.

    Empty where `best` leaves nothing detectable.
    """
    if not best.has_residual:
        return []
    fits = assess(context, fit_sets(context, grown(context, [best])[:WIDTH]))
    own, scatter = deviance(best.model), best.left.scatter
    found = [replace(e, gain=(own - deviance(e.model)) / scatter, by_run=np.zeros(0)) for e in fits]
    return sorted(found, key=lambda e: -e.gain)


def imitates(context: DiagnosisContext, best: Explanation, more: Sequence[Explanation]) -> bool:
    """Whether `best` explains less than SUFFICES of what it and one further term explain together, by likelihood.

    Further: the likeliest of `more`, fitted, or any candidate by its score. The nominal model and `best` have the noise
    levels of their own fits. An admissible one of `more` that leaves nothing detectable is a second cause.
    """
    if any(admissible(e) and not e.has_residual for e in more):
        return False
    gain = (context.deviance - deviance(best.model)) / best.left.scatter
    return explains_less(gain, best.further, *(e.gain for e in more))


def explains_less(gain: float, further: FloatArray, *more: float) -> bool:
    """Whether this gain is less than SUFFICES of it and the largest of the `further` ones together."""
    return gain < SUFFICES * (gain + max(float(further.max(initial=0.0)), *more, 0.0))


def present_too(context: DiagnosisContext, best: Explanation, more: Sequence[Explanation]) -> Explanation | None:
    """The likeliest admissible one of `more` sets than `best`; None without one that is told apart from the others.

    It must make each held-out run likelier, too, under the noise levels of each, and must not imitate another term.
    """
    sets = [e for e in more if admissible(e)]
    if not sets or sets[0].gain <= context.material(context.split.discover):
        return None
    if explains_less(sets[0].gain, sets[0].further) or any(is_close(e, sets[0]) for e in sets[1:]):
        return None
    try:
        gains = [run_deviance(best.model, k) - run_deviance(sets[0].model, k) for k in context.split.confirm]
    except FitError:  # a check that cannot be made has failed
        return None
    return sets[0] if min(gains) > 0.0 else None


def run_deviance(model: Model, run: int) -> float:
    """-2 log likelihood of a held-out run under the model's noise levels, up to a constant that all models share."""
    one = smooth(model, run)
    noise = one.state.noise
    return one.misfit(noise) + 2.0 * one.problem.log_volume(noise)
