"""`SensorFaults`: the faults of all sensors together, within their tolerances, by the scores of runs.

The tolerances are the prior (`estimator.score.marginal`). Sizes are right where nothing else is wrong, or little
compared with them. A law of the leg that explains more than all sensors together is estimated with them, without a
prior. A term that is not linear in its sizes, or is none of the library, makes the sizes worthless.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from daq import BoolArray, FloatArray, IndexArray
from estimator.effects import GenericReading, GenericTorque, SensorEffect
from estimator.likelihood import Candidate, LatentProblem
from estimator.score.marginal import discounted, marginalise, projected
from estimator.score.nuisances import Nuisance, Stated, nuisances_of
from estimator.score.score import Score, columns_of, total
from estimator.score.score_tests import project

BEYOND = 2.0
"""Tolerances, 1 sigma, beyond which a size is a fault: about the 95 % interval of what a rig may have."""
LAWS = 2
"""Most laws that may be wrong as well."""
WIDE = 1e3
"""Small sizes of a law that count as no prior."""


class Likeliest(NamedTuple):
    """Likeliest sizes within tolerances."""

    sizes: FloatArray
    """(k,)"""
    gain: float
    """Fall of -2 log likelihood by them, over the scatter between runs, ..."""
    by_laws: float
    """... and by laws without them"""


@dataclass(frozen=True)
class SensorFaults:
    """Faults of sensors that have a tolerance, among candidates that were scored at a fit."""

    candidates: Sequence[Candidate]
    columns: Sequence[IndexArray]
    """Of each candidate, counted from the first's."""
    free: BoolArray
    """(m,) which parameters of the fit are estimated; its scores have them before the candidates' columns."""
    held: frozenset[str]
    """Effects of the fit itself."""
    which: tuple[int, ...]
    """Candidates that are faults of sensors."""
    sizes: tuple[Nuisance, ...]
    """(k,) of all of these."""
    laws: tuple[int, ...] = ()
    """Candidates that are wrong as well, without a prior."""

    @classmethod
    def of(cls, candidates: Sequence[Candidate], problem: LatentProblem, free: BoolArray, stated: Stated
           ) -> Self:
        """Those of `Effect.usual` shapes that are no effects of the `problem`, with the tolerances `stated`."""
        held, which, sizes = frozenset(e.key for e in problem.effects), list[int](), list[Nuisance]()
        for i, one in enumerate(candidates):
            plain = isinstance(one.effect, SensorEffect) and not isinstance(one.effect, GenericReading)
            if plain and one.shape == one.effect.usual and one.effect.key not in held:
                own = nuisances_of([one], problem, stated)
                if all(size.tolerance > 0.0 for size in own):
                    which.append(i)
                    sizes += own
        return cls(candidates, columns_of(candidates), free, held, tuple(which), tuple(sizes))

    @property
    def tolerances(self) -> FloatArray:
        """(k,) of all sizes, 1 sigma."""
        return np.array([one.tolerance for one in self.sizes])

    def parts(self, values: NDArray[Any]) -> list[NDArray[Any]]:
        """`values` (k,) of each fault."""
        return np.split(values, np.cumsum([len(self.candidates[i].effect.sizes) for i in self.which])[:-1])

    def chosen(self, runs: Sequence[Score], least_gain: float) -> Self | None:
        """The faults whose sizes are within their tolerances by the scores of `runs`, with laws that are wrong, too.

        None where they gain less than `least_gain`, or less than what is beyond a tolerance, and where something else
        explains more.
        """
        found = self._with_laws(runs) if self.which else None
        if found is None:
            return None
        first = found.likeliest(runs)
        if first.gain < least_gain:
            return None
        far = [bool(part.any()) for part in found.parts(np.abs(first.sizes) > BEYOND * found.tolerances)]
        if not any(far):
            return found
        if all(far):
            return None
        sizes = found.parts(np.arange(len(found.sizes), dtype=float))
        within = replace(
            found, which=tuple(i for i, beyond in zip(found.which, far, strict=True) if not beyond),
            sizes=tuple(found.sizes[int(k)] for own, beyond in zip(sizes, far, strict=True) if not beyond for k in own),
            laws=(*found.laws, *(i for i, beyond in zip(found.which, far, strict=True) if beyond)))
        second = within.likeliest(runs)
        return None if second.gain < second.by_laws else within

    def likeliest(self, runs: Sequence[Score]) -> Likeliest:
        """The likeliest sizes."""
        p, count = self.free.size, len(self.sizes)
        wide = [Nuisance("law", "law", WIDE * s.scale) for i in self.laws for s in self.candidates[i].effect.sizes]
        own = [one.of(np.concatenate([np.arange(p), *(p + self.columns[i] for i in (*self.which, *self.laws))]))
               for one in runs]
        every = [*self.sizes, *wide]
        plain, _ = discounted(projected(total(own), self.free), self.free, own, every)
        found = marginalise(plain, every).sizes
        alone = marginalise(plain, [one._replace(tolerance=0.0) for one in self.sizes] + wide).sizes
        by_laws = float(plain.score @ alone)
        return Likeliest(found[:count], float(plain.score @ found) - by_laws, by_laws)

    def _with_laws(self, runs: Sequence[Score]) -> Self | None:
        """With each law that explains more than all sensors do in addition to the laws before; None where something
        else does, or where more laws do. Generic readings imitate what sensors do, and are not asked."""
        p, found = self.free.size, self
        skip = {self.candidates[i].effect.key for i in self.which} | self.held
        while True:
            taken = np.concatenate([np.zeros(0, int), *(self.columns[i] for i in found.laws)])
            left = np.setdiff1d(np.arange(runs[0].score.size - p), taken)
            order = np.concatenate([np.arange(p), p + taken, p + left])
            tests = project([one.of(order) for one in runs], p + taken.size)
            place = {int(column): k for k, column in enumerate(left)}
            gains = {i: tests.gain(np.array([place[int(c)] for c in self.columns[i]]))
                     for i, c in enumerate(self.candidates)
                     if c.effect.key not in skip and not isinstance(c.effect, GenericReading)}
            best = max(gains, key=lambda i: gains[i], default=None)
            if best is None or gains[best] < found.likeliest(runs).gain:
                return found
            effect = self.candidates[best].effect
            if len(found.laws) == LAWS or effect.shapes or isinstance(effect, SensorEffect | GenericTorque):
                return None
            found = replace(found, laws=(*found.laws, best))
            skip.add(effect.key)
