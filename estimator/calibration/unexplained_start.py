"""The start of a record in which the mechanism is not alone: a hand that holds it, a brake, a loop that switches on.

What the model cannot do there tells: the equation of motion, fitted to what follows, explains that, and at the start it
leaves most of the torques.
"""

from __future__ import annotations

import numpy as np

from daq import Dataset
from estimator.calibration.readings import filtered_motion, nothing_changed, slow_rows
from estimator.calibration.windows import inverse
from estimator.model import Mechanism
from estimator.options import FitOptions

BLOCK_S = 0.25
MOST = 0.5
"""Share of the record that a start is, at most."""
STRANGE, MOSTLY, EXPLAINED = 0.25, 0.5, 0.02
"""The residual's mean square as a share of that of all terms: such a start has more than the first in more than the
second share of its blocks. The blocks behind it have less than the third."""
BEHIND = 4
"""Blocks behind it that are asked, in which the terms have to be"""
ALIKE = 0.2
"""this share of those of the start: of small motion nothing follows for large motion."""
FRICTION = 2.0
"""Dry friction holds a joint against so many times what it has in motion."""


def unexplained_start(data: Dataset, mechanism: Mechanism, options: FitOptions) -> int:
    """Samples at the start of the record that the mechanism cannot explain; 0 for none.

    Raises `FitError` for a record without a segment.
    """
    motion = filtered_motion([data], mechanism, options).thinned()
    slow = slow_rows(motion, mechanism, options, nothing_changed(mechanism.n))
    if mechanism.exchanged or not slow.parts:
        return 0
    first, rows = slow.explained(np.eye(mechanism.n))[0]
    length = max(1, round(BLOCK_S * motion.rate_hz))
    count = len(rows) // length
    parts = rows[: count * length].reshape(count, length, *rows.shape[1:])
    grams = np.einsum("klna,klnb->kab", parts, parts)
    squares = np.einsum("klna->ka", parts**2)
    names = np.append([p.term for p in mechanism.parameters], ["offset"] * (slow.free.size - mechanism.p))
    dry, inertia = (np.flatnonzero(names[slow.free] == term) for term in ("coulomb", "inertia"))
    thin = round(len(data) / max(len(motion.q), 1))
    for k in range(3, int(MOST * count)):  # one strange block alone is no start
        behind = slice(k, None)
        gram = grams[behind].sum(axis=0)
        x = np.append(inverse(gram[:-1, :-1]) @ gram[:-1, -1], -1.0)
        left, terms = np.einsum("kab,a,b->k", grams, x, x), squares @ x**2
        held = FRICTION**2 * length * float(np.sum(x[dry] ** 2))
        start, after = slice(0, k - 1), slice(k, k + BEHIND)
        if (np.mean(left[start] > np.maximum(STRANGE * terms[start], held)) > MOSTLY
                and left[after].sum() < EXPLAINED * terms[after].sum()
                and terms[after].mean() > ALIKE * terms[start].mean()
                and np.all(x[inertia] > 0.0)):  # else a column is wrong, not the start
            return (first + k * length) * thin
    return 0
