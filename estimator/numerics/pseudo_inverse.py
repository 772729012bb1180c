"""`pseudo_inverse` and `inverse_root`: of information matrices that a record may leave singular, by one rule."""

from __future__ import annotations

import numpy as np

from daq import FloatArray

LEAST = 1e-13
"""Eigenvalues, of columns scaled to one, below which a direction counts as unknown; its variance is one over this."""

TINY = 1e-100
"""Least information that a column is scaled by: of one without any, the variance is huge and still a number."""


def pseudo_inverse(information: FloatArray, damping: float | FloatArray = 0.0) -> FloatArray:
    """Inverses of positive semidefinite matrices (..., p, p); near-null directions get a huge variance, no infinite
    one. `damping` (...) adds so much of its diagonal to each (Levenberg and Marquardt).
    """
    scale, values, vectors = _spectrum(information)
    values = np.maximum(values, LEAST) + np.asarray(damping)[..., None]
    both = scale[..., :, None] * scale[..., None, :]
    return np.asarray((vectors / values[..., None, :]) @ vectors.swapaxes(-1, -2) / both)


def inverse_root(information: FloatArray) -> FloatArray:
    """R (..., p, p) with R R' the inverse; near-null directions are left out."""
    scale, values, vectors = _spectrum(information)
    known = values > LEAST
    return np.asarray(vectors * (known / np.sqrt(np.where(known, values, 1.0)))[..., None, :] / scale[..., :, None])


def _spectrum(information: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(..., p) what columns are scaled by, and eigenvalues (..., p) and vectors (..., p, p) of them scaled to one."""
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", information), TINY))
    values, vectors = np.linalg.eigh(information / (scale[..., :, None] * scale[..., None, :]))
    return scale, values, vectors
