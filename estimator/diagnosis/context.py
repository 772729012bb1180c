"""`DiagnosisContext`: what its steps share: split runs, candidates, nominal model, and when a gain counts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.diagnosis.data_split import RunSplit
from estimator.diagnosis.decision_rule import ALPHA, MATERIAL
from estimator.diagnosis.noise_check import noise_dominated
from estimator.diagnosis.refit import Model, begin_afresh, deviance, short_errors
from estimator.diagnosis.score_statistics import RunScore, ScoreTests
from estimator.likelihood import Candidate

NO_TESTS = ScoreTests(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), 1.0, np.zeros(0))


@dataclass(frozen=True)
class Explanation:
    """One fitted set of effects, and the scores of its residual on the discover runs."""

    model: Model
    gain: float
    """Twice the log likelihood over the nominal model's."""
    left: ScoreTests = NO_TESTS
    has_residual: bool = True
    """Whether its residual has a detectable effect or generic term."""
    by_run: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(R,) misfit of each discover run, under the noise levels of those that it was weighed with"""
    error: float = 1.0
    """rms error of its free runs over a second on the discover runs, over the nominal model's"""
    inflation: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(m,) how much more variance than white noise gives them its parameters have; see `own_inflation`"""
    determined: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """(m,) whether these runs determine each of its parameters; see `score_statistics`"""
    further: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(K,) gain of each candidate in addition to it; zero for its own effects"""
    gain_over_parent: float = 0.0
    """Its gain over the likeliest explanation with one effect less"""

    def covariance(self) -> FloatArray:
        """(m, m) of the parameters that belong to the leg, from noise and scatter between runs."""
        model, width = self.model, self.model.width
        spread = np.sqrt(self.inflation[:width])
        return np.outer(spread, spread) * model.state.covariance[:width, :width]


def seated(found: Sequence[Explanation], most: int) -> list[Explanation]:
    """The first `most` of explanations, the likeliest first; the last place is for the one that simulates best.

    What is likeliest can be a sensor's small fault, which every sample shows and no simulation feels.
    """
    first, best = list(found[:most]), simulates_best(found)
    return first if best is None or any(best is e for e in first) else [*first[: most - 1], best]


def simulates_best(found: Sequence[Explanation]) -> Explanation | None:
    """The one with the least error of free runs, of those without a shape at a limit where it is another thing."""
    answers = [e for e in found if not any(effect.strict and effect.at_limits(size).any()
                                           for effect, size in zip(e.model.effects, e.model.sizes()))]
    return min(answers, key=lambda e: e.error, default=None)


@dataclass
class DiagnosisContext:
    """State that all steps share."""

    candidates: list[Candidate]
    columns: list[NDArray[np.intp]]
    named: int
    """The first so many candidates are of the library."""
    bias: list[RunScore]
    nominal: Model
    rng: np.random.Generator
    biases: dict[int, list[RunScore]] = field(default_factory=dict)
    """Number of effects to the `bias` of sets of so many; see assessment.bias_of"""
    held: dict[tuple[int, bytes], Model] = field(default_factory=dict)
    """Start of a fit to its end with shapes held, as far as another step may want it again, and ..."""
    whole: dict[tuple[int, bytes], Model] = field(default_factory=dict)
    """... to its end with shapes free; see `search.key_of`"""

    @property
    def split(self) -> RunSplit:
        """The runs, as they are split."""
        return self.nominal.split

    @cached_property
    def afresh(self) -> Model:
        """The nominal model at filtered motion, for fits that lead nowhere from its own fit."""
        return begin_afresh(self.nominal)

    @cached_property
    def deviance(self) -> float:
        """Deviance of the nominal model."""
        return deviance(self.nominal)

    @cached_property
    def short_errors(self) -> FloatArray:
        """(C,) of the nominal model, see `refit.short_errors`."""
        return short_errors(self.nominal)

    @cached_property
    def noise_dominated(self) -> str:
        """Why nothing found does not mean that nothing is wrong; empty where it does."""
        return noise_dominated(self.nominal)

    @property
    def trials(self) -> int:
        return len(self.candidates)

    def gain(self, tests: ScoreTests, i: int) -> float:
        """Gain of candidate i; zero for a size within the uncertainty of the recorder's clocks."""
        columns, open_size = self.columns[i], self.split.open_size(self.candidates[i].effect)
        if open_size > 0.0 and abs(float(tests.size(columns)[0])) < open_size:
            return 0.0
        return tests.gain(columns)

    def material(self, which: Sequence[int]) -> float:
        """Least gain that counts on these runs."""
        return MATERIAL**2 * sum(len(s.time_s) for s in self.split.signals(which))


def detected(context: DiagnosisContext, tests: ScoreTests, own: frozenset[str] = frozenset()) -> bool:
    """Whether anything is there, named or not, that none of a model's `own` effects is."""
    least = context.material(context.split.discover)
    return any(context.gain(tests, i) > least and p_of(context, tests, i) < ALPHA
               for i, c in enumerate(context.candidates) if c.effect.key not in own)


def keys_of(explanation: Explanation) -> frozenset[str]:
    """Its effects."""
    return frozenset(e.key for e in explanation.model.effects)


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
