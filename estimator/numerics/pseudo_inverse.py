"""`pseudo_inverse`: of information matrices that a record may leave singular."""

from __future__ import annotations

import numpy as np

from daq import FloatArray

LEAST = 1e-13
"""Eigenvalues, of columns scaled to one, below which a direction counts as unknown; its variance is one over this."""

TINY = 1e-100
"""Least information that a column is scaled by: of one without any, the variance is huge and still a number."""


def pseudo_inverse(information: FloatArray) -> FloatArray:
    """Inverses of positive semidefinite matrices (..., p, p); near-null directions get a huge variance, no infinite
    one.
    """
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", information), TINY))
    both = scale[..., :, None] * scale[..., None, :]
    values, vectors = np.linalg.eigh(information / both)
    return np.asarray((vectors / np.maximum(values, LEAST)[..., None, :]) @ vectors.swapaxes(-1, -2) / both)
