"""Which parameters, or combinations of them, a record cannot determine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.mechanism import Mechanism

FloatArray = NDArray[np.float64]


def undetermined(mechanism: Mechanism, beta: FloatArray, covariance: FloatArray,
                 free: NDArray[np.bool_]) -> tuple[str, ...]:
    """Names of parameters or combinations whose uncertainty exceeds what the rest of the model makes plausible.

    The covariance (p, p) is turned to scaled units: inertias against the largest inertia, gravity terms
    against the largest gravity term, friction against ten times its largest level. A direction with a standard
    deviation above one half of its scale is undetermined.
    """
    index = np.flatnonzero(free)
    if index.size == 0:
        return ()
    scale = _scales(mechanism, beta)[index]
    scaled = covariance[np.ix_(index, index)] / np.outer(scale, scale)
    if not np.isfinite(scaled).all():
        return tuple(mechanism.names[k] for k in index if not np.isfinite(covariance[k]).all())
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    zero = np.diag(scaled) <= 0.0
    found = [mechanism.names[k] for k in index[zero]]
    for value, vector in zip(values[::-1], vectors.T[::-1]):
        if value <= 0.25:
            break
        weight = vector / scale
        strong = np.abs(vector) > 0.15
        lead = int(np.argmax(np.abs(vector)))
        terms = [f"{weight[k] / weight[lead]:+.3g}*{mechanism.names[index[k]]}" if k != lead
                 else f"{mechanism.names[index[k]]}" for k in sorted(np.flatnonzero(strong), key=lambda k: k != lead)]
        found.append(" ".join(terms))
    return tuple(dict.fromkeys(found))


def _scales(mechanism: Mechanism, beta: FloatArray) -> FloatArray:
    """(p,) the size against which each parameter's uncertainty is judged."""
    scale = np.ones(mechanism.p)
    terms = np.array([a.term for a in mechanism.parameters])
    inertia = np.isin(terms, ["inertia", "rotor"])
    gravity = terms == "gravity"
    for group in (inertia, gravity):
        if group.any():
            scale[group] = max(float(np.max(np.abs(beta[group]))), 1e-12)
    torque = 0.02 * mechanism.gravity_mps2 * float(np.max(scale[gravity], initial=0.0))
    for term in ("viscous", "coulomb", "offset"):
        group = terms == term
        if group.any():  # a friction level may be zero: it counts when its error dwarfs every level of its kind
            scale[group] = 10.0 * max(float(np.max(np.abs(beta[group]))), torque, 1e-12)
    return scale
