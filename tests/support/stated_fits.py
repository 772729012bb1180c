"""Fits whose likelihoods are stated, for tests of what a search makes of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.diagnosis.context import Explanation
from estimator.score import NO_TESTS


@dataclass(frozen=True)
class Named:
    key: str
    strict: bool = True
    equivalence_class: str = ""
    joint: int | None = None
    starts: tuple[tuple[float, ...], ...] = ()

    def at_limits(self, size: NDArray[np.float64]) -> NDArray[np.bool_]:
        return size > 0.0


@dataclass(frozen=True)
class Fitted:
    """As much of a model as a search looks at."""

    effects: tuple[Named, ...]
    deviance: float
    at_limit: bool = False

    def sizes(self) -> list[Any]:
        return [np.array([float(self.at_limit)]) for _ in self.effects]


@dataclass
class Context:
    """As much of a context: `gains` of each candidate, as the scores of any model foresee it."""

    gains: dict[str, float] = field(default_factory=dict)
    starts: dict[str, tuple[tuple[float, ...], ...]] = field(default_factory=dict)
    deviance: float = 0.0
    short_errors: Any = None
    nominal: Fitted = field(default_factory=lambda: Fitted((), 0.0))
    split: Any = field(default_factory=lambda: SimpleNamespace(confirm=(1, 6), workers=1))
    held: dict[Any, Any] = field(default_factory=dict)
    whole: dict[Any, Any] = field(default_factory=dict)

    @property
    def candidates(self) -> list[Any]:
        return [SimpleNamespace(effect=Named(key, starts=self.starts.get(key, ()))) for key in self.gains]

    def gain(self, tests: object, i: int) -> float:
        return list(self.gains.values())[i]


def fitted(gain: float, *effects: str) -> Any:
    return Fitted(tuple(map(Named, effects)), -gain)


def explained(gain: float, *effects: str) -> Explanation:
    return Explanation(fitted(gain, *effects), gain, replace(NO_TESTS, inflation=np.ones(1)))
