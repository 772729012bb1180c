"""Torque samples whose noise is correlated between joints: eq. (31) with a full Sigma_tau.

A joint's row of the Jacobian is 1 + s by its own torque latent, s what effects make the reading depend on it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import FloatArray
from estimator.likelihood.normal_equations import Extra
from estimator.signals import torque_of

MOVING, LEAST_MOVING = 0.9, 0.1
"""Least share of a torque sample's variance that is noise, and least share of samples in which all joints have it so.
(Measured on an arm of dry friction, torques correlated by 0.8: with every sample by its share levels are 12 % low.)"""


def whole_samples(share: FloatArray, driven: Sequence[int]) -> FloatArray:
    """(N, n) `share` of each torque sample's variance that is noise; of `driven` joints 1 where none rests, else 0.

    Where one joint rests the correlated residuals of the others are not used; with too few such samples shares stay.
    """
    joints = list(driven)
    moving = np.min(share[:, joints], axis=1) > MOVING
    if np.mean(moving) < LEAST_MOVING:
        return share
    out = share.copy()
    out[:, joints] = moving[:, None]
    return out


def add_samples(residual: FloatArray, precision: FloatArray, extra: Extra | None, diagonal: FloatArray,
                gradient: FloatArray) -> float:
    """Add torque samples to the torque latents' blocks (N, n, n) and gradient (N, n); their part of the objective.

    `residual` (N, n) gets what effects add to the readings; `precision` is (N or 1, n, n) [1/(N m)^2].
    """
    if extra is not None:
        for i in range(residual.shape[1]):
            residual[:, i] += extra.readings.get(torque_of(i), 0.0)
    slope = _slope(residual, extra)
    weighted = np.einsum("kij,kj->ki", np.broadcast_to(precision, diagonal.shape), residual)
    diagonal += precision * slope[:, :, None] * slope[:, None, :]
    gradient += slope * weighted
    return float(np.vdot(residual, weighted))


def add_columns(residual: FloatArray, precision: FloatArray, extra: Extra, border: FloatArray, corner: FloatArray,
                gradient: FloatArray) -> None:
    """Add what the k sizes of effects do to torque readings to border (N, n, k), corner (k, k) and gradient (k,)."""
    columns = np.zeros(border.shape)
    for i in range(residual.shape[1]):
        if torque_of(i) in extra.reading_columns:
            which, values = extra.reading_columns[torque_of(i)]
            columns[:, i, which] = values.T
    weighted = precision @ columns
    border += _slope(residual, extra)[:, :, None] * weighted
    corner += np.einsum("kia,kib->ab", columns, weighted)
    gradient += np.einsum("kia,ki->a", weighted, residual)


def _slope(residual: FloatArray, extra: Extra | None) -> FloatArray:
    """(N, n) derivative of each torque reading by its joint's torque latent."""
    slope = np.ones(residual.shape)
    if extra is not None:
        for i in range(residual.shape[1]):
            slope[:, i] += extra.by_torque.get(torque_of(i), 0.0)
    return slope
