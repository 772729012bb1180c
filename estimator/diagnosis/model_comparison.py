"""`indistinguishable_set`: which closed explanations these runs cannot tell from the most likely one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimator.diagnosis.context import Explanation
from estimator.diagnosis.decision_rule import AGREE, TIE, TIE_ALIKE, TIE_GAIN, WIDEST
from estimator.diagnosis.presence import significant


def indistinguishable_set(adequate: Sequence[Explanation]) -> list[Explanation]:
    """The best of explanations by equally many effects, and those that are not told apart from it.

    The most likely stands for all, unless it leaves something detectable and another does not.
    """
    most, *others = sorted(adequate, key=lambda o: -o.gain)
    near = [most, *(o for o in others if is_close(o, most))]
    best = next((o for o in near if not o.has_residual), most)
    return distinguishable([best, *(o for o in near if o is not best and
                             (not o.has_residual or best.has_residual or equivalent(o, best)))])


def common_gain(other: Explanation, most: Explanation) -> float:
    """Gain of the `most` likely that a comparison with `other` is about: of the second causes of pairs with the same
    first cause."""
    return most.gain_over_parent if most.parent and most.parent == other.parent else most.gain


def is_close(other: Explanation, most: Explanation) -> bool:
    """Whether `other` is about as likely as the `most` likely."""
    share, short = common_gain(other, most), most.gain - other.gain
    if short <= share * (TIE_ALIKE if equivalent(other, most) else TIE) + TIE_GAIN:
        return True
    worse = other.by_run - most.by_run
    return bool(worse.sum() < AGREE * np.abs(worse).sum() and short <= share * WIDEST)


def equivalent(one: Explanation, other: Explanation) -> bool:
    """Whether two explanations differ by effects of one group only."""
    keys = {e.key for e in one.model.effects} & {e.key for e in other.model.effects}
    first, second = (sorted(e.equivalence_class or e.key for e in o.model.effects if e.key not in keys)
                     for o in (one, other))
    return first == second


def distinguishable(near: list[Explanation]) -> list[Explanation]:
    """Explanations that remain after effects of one group are told apart by their `Effect.distinguishing_size`.

    If the best has a significant one, those without it are removed. Otherwise explanations that equal another one with
    fewer sizes are removed: a spring of zero stiffness equals a torque offset.
    """
    best, others = near[0], near[1:]
    if set_apart(best):
        return [best, *(o for o in others if not equivalent(o, best) or set_apart(o))]
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
