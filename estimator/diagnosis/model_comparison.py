"""`tied`: which closed explanations these runs cannot tell from the most likely one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimator.diagnosis.context import Explained
from estimator.diagnosis.model_search import significant

TIE = 0.005
"""Explanations within this share of the best one's gain are not told apart ..."""
TIE_GAIN = 8.0
"""... or within this much of twice the log likelihood ..."""
TIE_ALIKE = 0.02
"""... nor those that differ by one effect for another of its group (`Effect.alike`) within this share ..."""
AGREE = 0.6
"""... nor where runs disagree: their differences in misfit sum to less than this share of their absolute values ..."""
WIDEST = 0.1
"""... and to less than this share of the gain. (A rotor and a scale of the encoder, 2.8 % apart: the runs differ by -75
to 81, and the confirm runs prefer the other one. Of five wrong rivals within 12 % on tuning seeds 11 and 12, those of
one group aside, no run preferred any by more than 6.)"""


def tied(closed: Sequence[Explained]) -> list[Explained]:
    """Of explanations by equally many effects, the best, and those that are not told apart from it.

    The most likely stands for all, unless it leaves something detectable and another does not.
    """
    most, *others = sorted(closed, key=lambda o: -o.gain)
    near = [most, *(o for o in others if close(o, most))]
    best = next((o for o in near if o.clean), most)
    return settled([best, *(o for o in near if o is not best and (o.clean or not best.clean or alike(o, best)))])


def close(other: Explained, most: Explained) -> bool:
    """Whether `other` is about as likely as the `most` likely.

    Second causes beside one and the same first are compared by what they add to it, not by the first one's gain
    too. (Measured: drag beside a late IMU gained 319,713 with it, and tied with Stribeck friction's 319,410; the late
    IMU had left 1,047.)
    """
    common = bool(most.beside) and most.beside == other.beside
    share, short = most.margin if common else most.gain, most.gain - other.gain
    if short <= share * (TIE_ALIKE if alike(other, most) else TIE) + TIE_GAIN:
        return True
    worse = other.by_run - most.by_run
    return bool(worse.sum() < AGREE * np.abs(worse).sum() and short <= share * WIDEST)


def alike(one: Explained, other: Explained) -> bool:
    """Whether two explanations differ by effects of one group only."""
    keys = {e.key for e in one.model.effects} & {e.key for e in other.model.effects}
    first, second = (sorted(e.alike or e.key for e in o.model.effects if e.key not in keys) for o in (one, other))
    return first == second


def settled(ties: list[Explained]) -> list[Explained]:
    """Ties among effects of one group settled by the sizes that set them apart (`Effect.apart`).

    Where the best has such a size, those without it are out. Where it has none, those are out that say no more than
    another does with fewer sizes: a spring without stiffness beside an offset of the torque.
    """
    best, others = ties[0], ties[1:]
    if set_apart(best):
        return [best, *(o for o in others if not alike(o, best) or set_apart(o))]
    plain = [o for o in ties if all(e.apart is None for e in o.model.effects if e.alike)]
    return [o for o in ties if set_apart(o) or o in plain or not any(nested(p, o) for p in plain)]


def set_apart(explained: Explained) -> bool:
    """Whether an effect of a group has the size that sets it apart from the others, beside its own scatter too.

    (Measured: an offset was named a spring of -0.02 N m/rad, 3.5 of its own deviations.)
    """
    spread = np.sqrt(np.maximum(explained.inflation, explained.left.scatter))
    return any(e.alike and e.apart is not None and significant(explained.model, k, spread)[e.apart]
               for k, e in enumerate(explained.model.effects))


def nested(plain: Explained, other: Explained) -> bool:
    """Whether `plain` is `other` with the size nil that sets it apart: first of its effect's sizes, all else equal."""
    return alike(plain, other) and any(e.alike and e.apart == 0 for e in other.model.effects)
