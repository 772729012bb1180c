"""`DiagnosisContext`: candidates, the nominal model and the tests of both; scores of what a model leaves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from daq import FloatArray, IndexArray
from estimator.diagnosis.data_split import RunSplit
from estimator.diagnosis.decision_rule import GENERIC_TERMS, MATERIAL
from estimator.diagnosis.explanation import Explanation, admissible, outperforms
from estimator.diagnosis.model import (
    Model,
    begin_afresh,
    predicted_train,
    refit,
    score_train,
)
from estimator.diagnosis.noise_check import noise_dominated
from estimator.diagnosis.result import CandidateScore
from estimator.diagnosis.tolerances import within_tolerance
from estimator.effects import Effect
from estimator.fit_errors import FIT_ERRORS
from estimator.likelihood import Candidate
from estimator.prediction import PredictedRun
from estimator.score import (
    ALPHA,
    NO_TESTS,
    Score,
    ScoreTests,
    columns_of,
    determined,
    own_inflation,
    project,
)

Progress = Callable[[str, float], None]
Start = list[tuple[Effect, FloatArray]]
"""Effects with the sizes at which a fit begins."""
GENERIC_STEPS = 12
"""Most steps of a fit with generic terms."""


@dataclass
class DiagnosisContext:
    """Candidates, how they are tested, and the nominal model: all steps of a search share them."""

    candidates: list[Candidate]
    columns: list[IndexArray]
    named: int
    """The first so many candidates are of the library."""
    nominal: Model
    rng: np.random.Generator
    share: float = MATERIAL
    """Least relative reduction of the free-run error that counts"""
    terms: Sequence[Effect] = ()
    """Effects that a fit of the train runs would choose as terms of its nominal model"""
    scores: tuple[Score, ...] = ()
    """(R,) of the nominal parameters and then of all candidates, one a train run"""
    whole: dict[bytes, Model] = field(default_factory=dict)
    """Start of a fit to its end; see `search.key_of`"""

    @property
    def split(self) -> RunSplit:
        """The runs, as they are split."""
        return self.nominal.split

    @cached_property
    def afresh(self) -> Model:
        """The nominal model at filtered motion, for fits that lead nowhere from its own fit."""
        return begin_afresh(self.nominal)

    @cached_property
    def predicted(self) -> tuple[PredictedRun, ...]:
        """(R,) free runs of the nominal model on the train runs."""
        return predicted_train(self.nominal)

    @cached_property
    def noise_dominated(self) -> str:
        """Why nothing found does not mean that nothing is wrong; empty where it does."""
        return noise_dominated(self.nominal)

    @property
    def own_scores(self) -> list[Score]:
        """(R,) of the nominal parameters alone, one a train run."""
        return [one.of(np.arange(self.split.mechanism.p)) for one in self.scores]

    @property
    def trials(self) -> int:
        return len(self.candidates)

    def gain(self, tests: ScoreTests, i: int) -> float:
        """Gain of candidate i."""
        return tests.gain(self.columns[i])

    @property
    def least_gain(self) -> float:
        """Least gain on the train runs that counts."""
        return MATERIAL**2 * self.nominal.problem.total


def scored(nominal: Model, candidates: list[Candidate], named: int, rng: np.random.Generator, say: Progress
           ) -> tuple[DiagnosisContext, ScoreTests]:
    """The scores of `candidates` at a nominal fit."""
    say("scoring the library", 0.15)
    scores = score_train(nominal, candidates)
    context = DiagnosisContext(candidates, columns_of(candidates), named, nominal, rng, scores=tuple(scores))
    return context, project(scores, nominal.problem.parameter_count)


def detected(context: DiagnosisContext, tests: ScoreTests, own: frozenset[str] = frozenset()) -> bool:
    """Whether anything is there, named or not, that none of a model's `own` effects is."""
    return any(context.gain(tests, i) > context.least_gain and p_of(context, tests, i) < ALPHA
               for i, c in enumerate(context.candidates) if c.effect.key not in own)


def p_of(context: DiagnosisContext, tests: ScoreTests, i: int) -> float:
    """p-value of candidate i over all that were tried; 1 of what counts for nothing."""
    if context.gain(tests, i) <= 0.0:
        return 1.0
    return min(1.0, tests.p_value(context.columns[i]) * context.trials)


def best_shapes(context: DiagnosisContext, tests: ScoreTests, skip: Sequence[str] = ()) -> list[int]:
    """Library candidates, best shape of each effect, by falling gain."""
    best: dict[str, int] = {}
    for i in range(context.named):
        key = context.candidates[i].effect.key
        if key not in skip and (key not in best or context.gain(tests, i) > context.gain(tests, best[key])):
            best[key] = i
    return sorted(best.values(), key=lambda i: -context.gain(tests, i))


def start_size(context: DiagnosisContext, tests: ScoreTests, i: int) -> FloatArray:
    """One-step sizes of candidate i, with its shape; zero for sizes that do not define it."""
    effect, shape = context.candidates[i].effect, context.candidates[i].shape
    size = np.zeros(len(effect.sizes))
    size[: effect.defining] = tests.size(context.columns[i][: effect.defining])
    if effect.positive:  # a bad nominal fit can mislead even the sign
        size[0] = abs(size[0])
    return np.concatenate([size, shape])


def rank(context: DiagnosisContext, tests: ScoreTests) -> tuple[CandidateScore, ...]:
    """Every effect of the library as scored."""
    out = []
    for i in best_shapes(context, tests):
        effect, columns = context.candidates[i].effect, context.columns[i]
        detectable = tests.detectable(int(columns[0]), ALPHA / context.trials, context.least_gain)
        out.append(CandidateScore(effect.name, effect.joint_number, float(np.sqrt(max(context.gain(tests, i), 0.0))),
                                  p_of(context, tests, i), float(tests.size(columns)[0]),
                                  max(detectable, context.split.open_size(effect)),
                                  context.split.mechanism.unit(effect.sizes[0].unit)))
    return tuple(out)


def separability(context: DiagnosisContext, tests: ScoreTests) -> tuple[tuple[str, ...], FloatArray]:
    """Cosines between what the best shapes of the library would add, nominal parameters projected out."""
    order = best_shapes(context, tests)[:14]
    first = np.array([context.columns[i][0] for i in order])
    information = tests.information[np.ix_(first, first)]
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    return tuple(context.candidates[i].effect.key for i in order), information / np.outer(scale, scale)


def generic_extension(context: DiagnosisContext, model: Model, left: ScoreTests) -> Model | None:
    """`model` with the generic terms of the largest gain on its residual, fitted together.

    None where no term is significant, or where they cannot be fitted.
    """
    chosen: list[int] = []
    for _ in range(GENERIC_TERMS):
        known = left.gain(_columns(context, chosen)) if chosen else 0.0
        gains = {i: left.gain(_columns(context, [*chosen, i])) - known
                 for i in range(context.named, context.trials) if i not in chosen}
        best = max(gains, key=lambda i: gains[i])
        if gains[best] < context.least_gain or (not chosen and p_of(context, left, best) > ALPHA):
            break
        chosen.append(best)
    if not chosen:
        return None
    start = list(zip(model.effects, model.sizes()))
    start += [(context.candidates[i].effect, start_size(context, left, i)) for i in chosen]
    for count in range(len(start), len(model.effects), -1):  # fewer where all together do not converge
        try:
            return refit(model, start[:count], GENERIC_STEPS)
        except FIT_ERRORS:
            continue
    return None


def with_generic(context: DiagnosisContext, explanation: Explanation) -> Model:
    """The model of an assessed explanation with generic terms, its own where none is significant; fitted once."""
    model = explanation.model
    return model.once("generic", lambda: generic_extension(context, model, explanation.left) or model)


def _columns(context: DiagnosisContext, which: Sequence[int]) -> IndexArray:
    return np.concatenate([context.columns[i] for i in which])


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


def without(sets: Sequence[Explanation], others: Sequence[Explanation]) -> list[Explanation]:
    """Those of `sets` whose models are not among those of the `others`."""
    return [e for e in sets if not any(e.model is o.model for o in others)]


def assess(context: DiagnosisContext, explanations: Sequence[Explanation]) -> list[Explanation]:
    """Each with the scores of what it leaves on the train runs; as it is where it has them."""
    return [replace(e, **e.model.once("assessed", partial(assessed, context, e))) if e.left is NO_TESTS else e
            for e in explanations]


def assessed(context: DiagnosisContext, explanation: Explanation) -> dict[str, Any]:
    """Fields of an explanation that its scores on the train runs fill."""
    model = explanation.model
    scores = score_train(model, context.candidates)
    left = project(scores, model.problem.parameter_count)
    free = np.diag(model.state.covariance) > 0.0
    keys = explanation.keys
    further = np.array([0.0 if c.effect.key in keys else context.gain(left, i)
                        for i, c in enumerate(context.candidates)])
    return dict(left=left, has_residual=detected(context, left, keys), further=further,
                within=within_tolerance(model, model.whole_sizes()),
                inflation=own_inflation(scores, free, left.scatter), determined=determined(scores, free),
                scores=tuple(s.of(np.arange(model.problem.parameter_count)) for s in scores))
