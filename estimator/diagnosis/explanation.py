"""`Explanation`: a fitted set of effects; whether each effect is present, and which explanations these runs tell apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from daq import BoolArray, FloatArray
from estimator.diagnosis.decision_rule import MOST_EFFECTS, SURE, WIDTH
from estimator.diagnosis.model import Model
from estimator.diagnosis.tolerances import with_tolerances, within_tolerance
from estimator.numerics import student_quantile
from estimator.score import NO_TESTS, Score, ScoreTests, least_sigmas

LEAST_APART = 2.0 * float(np.log(SURE / (1.0 - SURE)))
"""Difference in gain at which one explanation has the probability SURE, of two."""


@dataclass(frozen=True)
class Explanation:
    """One fitted set of effects, and the scores of its residual on the train runs."""

    model: Model
    gain: float
    """Twice the log likelihood over the nominal model's."""
    left: ScoreTests = NO_TESTS
    has_residual: bool = True
    """Whether its residual has a detectable effect or generic term."""
    by_run: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(R,) misfit of each train run, under the noise levels of those that it was weighed with"""
    error: float = 1.0
    """rms error of its free runs over a second on the train runs, over the nominal model's, sensors alike"""
    inflation: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(m,) how much more variance than white noise gives them its parameters have; see `own_inflation`"""
    determined: BoolArray = field(default_factory=lambda: np.zeros(0, bool))
    """(m,) whether these runs determine each of its parameters; see `estimator.score`"""
    further: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(K,) gain of each candidate in addition to it; zero for its own effects"""
    scores: tuple[Score, ...] = ()
    """(R,) of its own parameters, one a train run"""
    within: frozenset[str] = frozenset()
    """Keys of its effects whose sizes the tolerances of the rig hold; see also `as_told`"""

    @property
    def keys(self) -> frozenset[str]:
        """Its effects."""
        return frozenset(e.key for e in self.model.effects)

    @property
    def beyond(self) -> frozenset[str]:
        """Its effects that no tolerance of the rig holds."""
        return self.keys - self.within

    @cached_property
    def estimate(self) -> tuple[FloatArray, FloatArray]:
        """(m,) parameters and sizes after the step of `with_tolerances`, with what is taken off; (m, m) covariance."""
        model, spread = self.model, np.sqrt(self.inflation)
        values, covariance = with_tolerances(model, np.outer(spread, spread) * model.state.covariance)
        taken = np.concatenate([np.zeros(model.split.mechanism.p), *map(model.taken_of, model.effects)])
        return values + taken, covariance

    def sizes(self) -> list[FloatArray]:
        """One size vector an effect, of its `estimate`; those of the model are at its optimum."""
        return [self.estimate[0][here] for here in self.model.places()]

    @cached_property
    def half_widths(self) -> FloatArray:
        """(m,) of their 95 % intervals, by Student's t of their own scatter between runs."""
        return np.asarray(student_quantile(self.left.freedom) * np.sqrt(np.diag(self.estimate[1])))

    def as_told(self) -> Explanation:
        """The explanation with `within` by the sizes that are told, not by those at the model's optimum.

        An effect counts as within its tolerance if its sizes are, or if all their intervals hold zero.
        """
        sizes = self.sizes()
        zero = {e.key for e, size, here in zip(self.model.effects, sizes, self.model.places()) if np.all(
            np.abs(size)[: len(e.sizes)] <= self.half_widths[here][: len(e.sizes)])}
        return replace(self, within=within_tolerance(self.model, sizes) | zero)


def seated(explanations: Sequence[Explanation], most: int) -> list[Explanation]:
    """The first `most` of explanations, the likeliest first; the last place is for the one that simulates best.

    What is likeliest can be a sensor's small fault, which every sample shows and no simulation feels.
    """
    first, best = list(explanations[:most]), simulates_best(explanations)
    return first if best is None or any(best is e for e in first) else [*first[: most - 1], best]


def by_error(options: Sequence[Explanation]) -> list[Explanation]:
    """Explanations by rising error of free runs over a second on the train runs; inadmissible ones last.

    The first gives the noise that is the unit: the likeliest can be a small fault of a sensor, which takes for noise
    what the simulation lacks.
    """
    return sorted(options, key=lambda o: (not admissible(o), o.error))


def first_of_each(options: Sequence[Explanation]) -> list[Explanation]:
    """The first of each number of effects, the fewest effects first."""
    counts = sorted({len(o.model.effects) for o in options})
    return [o for n in counts for o in seated([o for o in options if len(o.model.effects) == n], WIDTH)]


def shortlisted(options: Sequence[Explanation]) -> list[Explanation]:
    """The likeliest explanations, of each number of effects at least `WIDTH`, and each set of effects once."""
    every = sorted(options, key=lambda o: -o.gain)
    ranked = [o for k, o in enumerate(every) if not any(o.keys == e.keys for e in every[:k])]
    first = first_of_each(ranked)
    return [*first, *(o for o in ranked if not any(o is f for f in first))][: MOST_EFFECTS * WIDTH]


def simulates_best(explanations: Sequence[Explanation]) -> Explanation | None:
    """The one with the least error of free runs, of those without a shape at a limit where it is another thing."""
    answers = [e for e in explanations if not any(effect.strict and effect.at_limits(size).any()
                                                  for effect, size in zip(e.model.effects, e.model.sizes()))]
    return min(answers, key=lambda e: e.error, default=None)


def admissible(explanation: Explanation) -> bool:
    """Whether each of its effects is significant, with a possible sign."""
    return all(presence(explanation))


def presence(explanation: Explanation) -> list[bool]:
    """For each effect, whether a defining size is significant, none is impossible, and shapes are in range.

    A gear of zero compliance with friction and inertia of its motor is no elastic gear.
    """
    out = []
    for k, (effect, size) in enumerate(zip(explanation.model.effects, explanation.model.sizes())):
        counts = significant(explanation, k)
        below = size[: effect.positive] < 0.0
        wrong = ((below & counts[: effect.positive]).any() or (effect.strict and effect.at_limits(size).any())
                 or not effect.possible(size))
        out.append(bool(counts[: effect.defining].any() and not wrong))
    return out


def undetermined(explanation: Explanation) -> list[bool]:
    """For each effect, whether the other effects and the nominal parameters replace all its defining sizes."""
    model = explanation.model
    return [not explanation.determined[here][: len(effect.sizes)][: effect.defining].any()
            for effect, here in zip(model.effects, model.places())]


def significant(explanation: Explanation, which: int) -> BoolArray:
    """For each size of one effect, whether it is determined and differs from zero by `least_sigmas`.

    These allow for its scatter between runs, as its interval does, and for that of all tests.
    """
    model = explanation.model
    here = model.places()[which]
    std = (np.sqrt(np.maximum(explanation.inflation, explanation.left.scatter)) * model.std())[here]
    least = least_sigmas(explanation.further.size)
    counts = explanation.determined[here] & (np.abs(model.sizes()[which]) > least * std)
    return np.asarray(counts[: len(model.effects[which].sizes)])


def outperforms(one: Explanation, other: Explanation) -> bool:
    """Whether `one`, assessed, has as many effects as the `other`, a smaller error, and a larger gain beyond any tie:
    the `margin` of the other is at most the largest gain that one further effect adds to this one."""
    return (len(one.model.effects) == len(other.model.effects) and one.error < other.error
            and one.gain - other.gain > one.left.scatter * (one.further.max(initial=0.0) + LEAST_APART))


def indistinguishable_set(adequate: Sequence[Explanation]) -> list[Explanation]:
    """The best of explanations by equally many effects, and those that are not told apart from it.

    The most likely stands for all, unless it leaves something detectable and another does not.
    """
    most, *others = sorted(adequate, key=lambda o: -o.gain)
    near = [most, *(o for o in others if is_close(o, most) or (both_leave(o, most) and equivalent(o, most)))]
    best = next((o for o in near if not o.has_residual), most)
    return distinguishable([best, *(o for o in near if o is not best and
                             (not o.has_residual or best.has_residual or equivalent(o, best)))])


def fewest_beyond(near: Sequence[Explanation]) -> list[Explanation]:
    """Those of explanations that are not told apart with the fewest effects beyond the tolerances of the rig."""
    least = min(len(o.beyond) for o in near)
    return [o for o in near if len(o.beyond) == least]


def is_close(other: Explanation, most: Explanation) -> bool:
    """Whether these runs do not tell `other` from the `most` likely with the probability SURE.

    Two explanations that are D apart in gain have the odds exp(-(D - L) / 2), L their `margin`. Or more than a share
    1 - SURE of the differences between them, run by run, is in favour of `other`.
    """
    worse = other.by_run - most.by_run
    return bool(most.gain - other.gain <= margin(other, most) + LEAST_APART
                or np.maximum(-worse, 0.0).sum() > (1.0 - SURE) * np.abs(worse).sum())


def both_leave(explanation: Explanation, other: Explanation) -> bool:
    """Whether both leave something detectable that is worth more than the difference between them.

    What neither explains then decides which is the likelier: effects of one group, which only their
    `Effect.distinguishing_size` tells apart, are not told apart by it.
    """
    left = min(explanation.further.max(initial=0.0), other.further.max(initial=0.0))
    return explanation.has_residual and other.has_residual and abs(explanation.gain - other.gain) <= left


def margin(other: Explanation, most: Explanation) -> float:
    """Gain by which one further effect, listed or generic, would bring `other` nearer to the `most` likely.

        L = max_k min(g_k(other) - g_k(most), g_k(most))

    g_k is the gain of effect k in addition to each. It counts no more than in addition to the most likely: what
    explains nothing there only imitates that one.
    """
    imitated = np.minimum(other.further - most.further, most.further)
    return float(imitated.max(initial=0.0))


def equivalent(explanation: Explanation, other: Explanation) -> bool:
    """Whether two explanations differ by effects of one group only."""
    keys = {e.key for e in explanation.model.effects} & {e.key for e in other.model.effects}
    first, second = (sorted(e.equivalence_class or e.key for e in o.model.effects if e.key not in keys)
                     for o in (explanation, other))
    return first == second


def distinguishable(near: list[Explanation]) -> list[Explanation]:
    """Explanations that remain after effects of one group are told apart by their `Effect.distinguishing_size`.

    If the best has a significant one, those without it are removed, but where what both leave is worth more: it may be
    that which the size stands for. Otherwise explanations that equal another one with fewer sizes are removed: a spring
    of zero stiffness equals a torque offset.
    """
    best, others = near[0], near[1:]
    if set_apart(best):
        return [best, *(o for o in others if not equivalent(o, best) or set_apart(o) or both_leave(o, best))]
    plain = [o for o in near if all(e.distinguishing_size is None for e in o.model.effects if e.equivalence_class)]
    return [o for o in near if set_apart(o) or any(o is p for p in plain) or not any(nested(p, o) for p in plain)]


def set_apart(explanation: Explanation) -> bool:
    """Whether an effect of a group has a significant distinguishing size."""
    return any(e.equivalence_class and e.distinguishing_size is not None
               and significant(explanation, k)[e.distinguishing_size]
               for k, e in enumerate(explanation.model.effects))


def nested(plain: Explanation, other: Explanation) -> bool:
    """Whether `plain` is `other` with a distinguishing size of zero: the first of its effect, all else equal."""
    return equivalent(plain, other) and any(e.equivalence_class and e.distinguishing_size == 0
                                            for e in other.model.effects)
