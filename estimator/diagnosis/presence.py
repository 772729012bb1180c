"""`admissible`: whether each effect of a fitted set is present, by sizes that these runs determine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.diagnosis.context import Explanation
from estimator.score import least_sigmas


def admissible(explanation: Explanation) -> bool:
    """Whether each of its effects is significant, with a possible sign."""
    return all(presence(explanation))


def presence(explanation: Explanation) -> list[bool]:
    """For each effect, whether a defining size is significant, no size has an impossible sign, and shapes are in range.

    A gear of zero compliance with friction and inertia of its motor is no elastic gear.
    """
    out = []
    for k, (effect, size) in enumerate(zip(explanation.model.named, explanation.model.sizes())):
        counts = significant(explanation, k)
        below = size[: effect.positive] < 0.0
        wrong = (below & counts[: effect.positive]).any() or (effect.strict and effect.at_limits(size).any())
        out.append(bool(counts[: effect.defining].any() and not wrong))
    return out


def undetermined(explanation: Explanation) -> list[bool]:
    """For each effect, whether the other effects and the nominal parameters replace all its defining sizes."""
    model = explanation.model
    return [not explanation.determined[here][: len(effect.sizes)][: effect.defining].any()
            for effect, here in zip(model.named, model.places())]


def significant(explanation: Explanation, which: int) -> NDArray[np.bool_]:
    """For each size of one effect, whether it is determined and differs from zero by `least_sigmas`.

    These allow for its scatter between runs, as its interval does, and for that of all tests.
    """
    model = explanation.model
    here = model.places()[which]
    std = (np.sqrt(np.maximum(explanation.inflation, explanation.left.scatter)) * model.std())[here]
    least = least_sigmas(explanation.further.size)
    counts = explanation.determined[here] & (np.abs(model.sizes()[which]) > least * std)
    return np.asarray(counts[: len(model.effects[which].sizes)])
