"""`pseudo_inverse`: of information matrices that a record may leave singular."""

from __future__ import annotations

import numpy as np

from daq import FloatArray

LEAST = 1e-13
"""Eigenvalues, of columns scaled to one, below which a direction counts as unknown; its variance is one over this."""


def pseudo_inverse(information: FloatArray) -> FloatArray:
    """Inverses of positive semidefinite matrices (..., p, p); near-null directions get a huge variance, no infinite
    one.
    """
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", information), 1e-300))
    both = scale[..., :, None] * scale[..., None, :]
    values, vectors = np.linalg.eigh(information / both)
    with np.errstate(over="ignore"):
        inverse: FloatArray = (vectors / np.maximum(values, LEAST)[..., None, :]) @ vectors.swapaxes(-1, -2) / both
    return inverse
