"""Fits whose likelihoods are stated, for tests of what a search and a verdict make of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from daq import FloatArray
from estimator.diagnosis.context import DiagnosisContext
from estimator.diagnosis.explanation import Explanation
from estimator.likelihood import Candidate
from estimator.score import NO_TESTS, ScoreTests, columns_of

TOTAL = 12_000
"""Samples: an effect that gains less than 120 is not looked at."""
SIGNIFICANT, AT_LIMIT = 9.0, np.inf
"""Sizes, in standard deviations."""
NOTHING_LEFT = replace(NO_TESTS, inflation=np.ones(1))


@dataclass(frozen=True)
class Named:
    """As much of an effect of one size as is looked at."""

    name: str
    joint: int | None = None
    strict: bool = True
    equivalence_class: str = ""
    distinguishing_size: int | None = None
    starts: tuple[tuple[float, ...], ...] = ()
    sizes: tuple[None, ...] = (None,)
    shapes: tuple[()] = ()
    defining: int = 1
    positive: int = 0
    count: int = 1

    @property
    def joint_number(self) -> int | None:
        return None if self.joint is None else self.joint + 1

    @property
    def key(self) -> str:
        return self.name

    def possible(self, size: FloatArray) -> bool:
        return True

    def at_limits(self, size: FloatArray) -> FloatArray:
        return np.isinf(size)


@dataclass(frozen=True, eq=False)
class Fitted:
    """As much of a model as is looked at, with a stated log likelihood; the size of each effect in its deviations."""

    effects: tuple[Named, ...]
    log_marginal: float = 0.0
    size: float = SIGNIFICANT

    @property
    def split(self) -> Any:
        return SimpleNamespace(workers=1, open_size=lambda effect: 0.0, tolerances=None)

    @property
    def state(self) -> Any:
        return SimpleNamespace(x=None, beta=None, noise=None)

    @property
    def problem(self) -> Any:
        return SimpleNamespace(total=TOTAL)

    def sizes(self) -> list[FloatArray]:
        return [np.array([self.size]) for _ in self.effects]

    def places(self) -> list[slice]:
        return [slice(k, k + 1) for k in range(len(self.effects))]

    def std(self) -> FloatArray:
        return np.ones(len(self.effects))


def fitted(gain: float, *effects: str | Named, size: float = SIGNIFICANT) -> Any:
    """A model that is likelier by `gain` than the nominal one."""
    return Fitted(tuple(Named(e) if isinstance(e, str) else e for e in effects), gain / 2.0, size)


def explained(gain: float, *effects: str | Named, size: float = SIGNIFICANT, further: Sequence[float] = (),
              error: float = 1.0, has_residual: bool = False) -> Explanation:
    """An assessed explanation whose gain all of six runs share alike."""
    count = len(effects)
    return Explanation(fitted(gain, *effects, size=size), gain, NOTHING_LEFT, has_residual, np.full(6, -gain / 6.0),
                       error, np.ones(count), np.ones(count, dtype=bool), np.array(further, dtype=float))


def predicted_by_scores(gains: Mapping[Named, float]) -> tuple[DiagnosisContext, ScoreTests]:
    """A context with these effects for candidates, and scores that foresee these gains of each, alone."""
    candidates = [Candidate(cast(Any, effect)) for effect in gains]
    count = len(candidates)
    score = np.sqrt(np.array(list(gains.values())))
    tests = ScoreTests(score[None], score, np.eye(count), np.ones(count), 13.0, np.ones(count), np.zeros((0, count)))
    return DiagnosisContext(candidates, columns_of(candidates), count, fitted(0.0),
                            np.random.default_rng(0)), tests
