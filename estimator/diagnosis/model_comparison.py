"""`indistinguishable_set`: which closed explanations these runs cannot tell from the most likely one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimator.diagnosis.context import Explanation
from estimator.diagnosis.decision_rule import SURE
from estimator.diagnosis.presence import significant

LEAST_APART = 2.0 * float(np.log(SURE / (1.0 - SURE)))
"""Difference in gain at which one explanation has the probability SURE, of two."""


def indistinguishable_set(adequate: Sequence[Explanation]) -> list[Explanation]:
    """The best of explanations by equally many effects, and those that are not told apart from it.

    The most likely stands for all, unless it leaves something detectable and another does not.
    """
    most, *others = sorted(adequate, key=lambda o: -o.gain)
    near = [most, *(o for o in others if is_close(o, most))]
    best = next((o for o in near if not o.has_residual), most)
    return distinguishable([best, *(o for o in near if o is not best and
                             (not o.has_residual or best.has_residual or equivalent(o, best)))])


def is_close(other: Explanation, most: Explanation) -> bool:
    """Whether these runs do not tell `other` from the `most` likely with the probability SURE.

    Two explanations that are D apart in gain have the odds exp(-(D - L) / 2), L their `margin`. Or more than a share
    1 - SURE of the differences between them, run by run, is in favour of `other`.
    """
    worse = other.by_run - most.by_run
    return bool(most.gain - other.gain <= margin(other, most) + LEAST_APART
                or np.maximum(-worse, 0.0).sum() > (1.0 - SURE) * np.abs(worse).sum())


def margin(other: Explanation, most: Explanation) -> float:
    """Gain by which one further effect, listed or generic, would bring `other` nearer to the `most` likely.

        L = max_k min(g_k(other) - g_k(most), g_k(most))

    g_k is the gain of effect k in addition to each. It counts no more than in addition to the most likely: what
    explains nothing there only imitates that one.
    """
    imitated = np.minimum(other.further - most.further, most.further)
    return float(imitated.max(initial=0.0))


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
