"""Parameters, or combinations of them, that a record does not determine.

A combination is named by a direction: "beta2 -0.8*beta3" are amounts by which the parameters can change together
without this data noticing.
"""

from __future__ import annotations

import numpy as np

from daq import BoolArray, FloatArray
from estimator.model import Mechanism
from estimator.result import Combination

LARGEST_STD = 0.5
"""A direction whose standard deviation exceeds this share of its scale is undetermined."""
SAME_DIRECTION = 0.3
"""Sine of the angle below which two directions count as one."""
CERTAIN = 2.0
"""Standard deviations by which a value that others are judged by must differ from zero."""
SMALL_SHARE = 0.1
"""Parameters that take part by less than this share of the one that leads are left out of a name."""


def undetermined(mechanism: Mechanism, beta: FloatArray, covariance: FloatArray,
                 free: BoolArray) -> tuple[Combination, ...]:
    """Names of parameters or combinations whose uncertainty exceeds what the rest of the model makes plausible.

    The covariance (p, p) is judged in the units of `plausible_sizes`.
    """
    index = np.flatnonzero(free)
    if index.size and not np.isfinite(covariance[np.ix_(index, index)]).all():
        return tuple(Combination(((mechanism.names[k], 1.0),)) for k in index if not np.isfinite(covariance[k]).all())
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = plausible_sizes(mechanism, beta, std)
    unseen = free & (std <= 0.0)
    return name_directions(mechanism.names, uncertain_directions(covariance, scale, free), scale,
                           unseen | (std > LARGEST_STD * scale))


def uncertain_directions(covariance: FloatArray, scale: FloatArray, free: BoolArray) -> FloatArray:
    """(p, k) orthonormal, in units of `scale` (p,): those with a standard deviation above `LARGEST_STD`.

    A free parameter without any variance was not seen at all: its column of the regressor is zero.
    """
    index = np.flatnonzero(free)
    scaled = covariance[np.ix_(index, index)] / np.outer(scale[index], scale[index])
    unseen = np.diag(scaled) <= 0.0
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    out = np.zeros((scale.size, index.size))
    out[index] = vectors
    alone = np.eye(scale.size)[:, index[unseen]]
    return np.hstack([alone, out[:, values > LARGEST_STD**2]])


def name_directions(names: tuple[str, ...], directions: FloatArray, scale: FloatArray,
                    wide: BoolArray | None = None) -> tuple[Combination, ...]:
    """One combination for each independent direction (p, k), given in units of `scale` (p,).

    `wide` (p,) says whose own standard deviation is too large. Where the leader's is, a name leaves out the others
    whose is not: their intervals hold what the direction adds to them. Without `wide` all are named.
    Any basis of the same space says the same; the one chosen gives every one a parameter of its own to lead.
    """
    u, s, _ = np.linalg.svd(directions, full_matrices=False)
    basis = u[:, s > SAME_DIRECTION]
    if basis.shape[1] == 0:
        return ()
    from scipy.linalg import qr

    leads = qr(basis.T, mode="r", pivoting=True)[1][: basis.shape[1]]
    own = basis @ np.linalg.inv(basis[leads])  # the leads' rows are now the unit matrix
    found = []
    for lead, shares in sorted(zip(leads.tolist(), own.T), key=lambda pair: pair[0]):
        others = [k for k in np.flatnonzero(np.abs(shares) >= SMALL_SHARE)
                  if k != lead and (wide is None or wide[k] or not wide[lead])]
        amounts = shares * scale / scale[lead]
        found.append(Combination(tuple((names[k], float(amounts[k])) for k in (lead, *others))))
    return tuple(found)


def plausible_sizes(mechanism: Mechanism, beta: FloatArray, std: FloatArray | None = None) -> FloatArray:
    """(p,) the size against which each parameter's uncertainty is judged.

    Inertias against the largest inertia, gravity terms against the largest gravity term, friction against ten times
    its largest level. With `std` (p,) only values count that stand out of it, where there are any: of a joint that
    never moves friction may come out at 1e44 +- 9e44, and is no measure of anything.
    """
    scale = np.ones(mechanism.p)
    if std is not None:
        sure = np.abs(beta) > CERTAIN * std
        beta = np.where(_in_group_of(mechanism, sure) & ~sure, 0.0, beta)
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


def _in_group_of(mechanism: Mechanism, sure: BoolArray) -> BoolArray:
    """(p,) whether a parameter is judged together with one that is `sure` (p,)."""
    terms = np.array(["inertia" if p.term == "rotor" else p.term for p in mechanism.parameters])
    return np.isin(terms, terms[sure])
