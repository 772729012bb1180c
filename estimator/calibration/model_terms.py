"""Extra terms of the nominal model that a set of records needs: rotor inertias and torque offsets, by prediction.

Leave-one-out cross-validation of slow least squares: a term is needed if it reduces the residual of the held-out runs'
torque. Noise levels and grids have no influence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from daq import Dataset, FloatArray
from estimator.fitting import design_rows, free_mask, weighted_least_squares
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals import split_signals

SLOW_HZ, OVERSAMPLED = 3.0, 16.0
"""Band in which terms are looked for, and the samples that are kept of one of its periods."""
OPTIONAL = ("rotor", "offset")
LEAST_FALL = 0.03
"""Least relative reduction of the residual, at the joint where it is largest, ... (Measured: 13 to 54 % on two real
arms and a slide that need the terms; below 0.3 % on healthy legs.)"""
MOST_RISE = 0.02
"""... and by which it may rise at another."""
LEAST_SIZE = 5.0
"""Standard deviations of its own, all runs together, that a term must have."""
FOLDS, FOLD_S = 4, 4.0
"""Most parts of a single run, and the least length of one [s]; a shorter run says nothing of itself."""


def needed_terms(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> Mapping[str, float]:
    """Needed `OPTIONAL` parameters of `mechanism` -> relative reduction of the held-out torque residual.

    `mechanism` has all optional parameters. Raises `FitError`.
    """
    parts = datasets if len(datasets) > 1 else _folds(datasets[0])
    if len(parts) < 2:
        return {}
    slow = replace(options, cutoff_hz=min(SLOW_HZ, options.cutoff(datasets[0].rate_hz)), hold="linear")
    blocks, samples_per_dof = [], 1.0
    for part in parts:
        design = design_rows(split_signals([part], mechanism, slow), mechanism, slow)
        thin = max(1, int(datasets[0].rate_hz / (OVERSAMPLED * SLOW_HZ)))
        blocks.append((design.z[::thin], design.torque[::thin]))
        samples_per_dof = max(1.0, design.samples_per_dof / thin)
    free, start = free_mask(mechanism, slow)
    optional = {p.name: k for k, p in enumerate(mechanism.parameters) if p.term in OPTIONAL and free[k]}
    free[list(optional.values())] = False
    found: dict[str, float] = {}
    left = _held_out(blocks, free, start)
    while len(found) < len(optional):
        tried = {name: _held_out(blocks, free | (np.arange(free.size) == k), start)
                 for name, k in optional.items() if name not in found}
        name = min(tried, key=lambda n: float(np.min(tried[n] / left)))
        fall = 1.0 - float(np.min(tried[name] / left))
        free[optional[name]] = True
        sure = _size(blocks, free, start, samples_per_dof)[optional[name]] > LEAST_SIZE
        if fall < LEAST_FALL or not sure or np.any(tried[name] > (1.0 + MOST_RISE) * left):
            break
        found[name], left = fall, tried[name]
    return found


def _size(blocks: Sequence[tuple[FloatArray, FloatArray]], free: np.ndarray, start: FloatArray, samples_per_dof: float
          ) -> FloatArray:
    """(p,) least squares of all blocks, each value in its standard deviations."""
    z, torque = map(np.concatenate, zip(*blocks))
    beta, covariance, _ = weighted_least_squares(z, torque, free, start, samples_per_dof)
    size: FloatArray = np.abs(beta) / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return size


def _folds(data: Dataset) -> list[Dataset]:
    count = min(FOLDS, int(len(data) / data.rate_hz / FOLD_S))
    edges = np.linspace(0, len(data), count + 1).astype(int)
    return [data.part(slice(int(a), int(b))) for a, b in pairwise(edges)]


def _held_out(blocks: Sequence[tuple[FloatArray, FloatArray]], free: np.ndarray, start: FloatArray) -> FloatArray:
    """(n,) rms torque residual of each block under least squares on the other blocks."""
    squares, count = np.zeros(blocks[0][1].shape[1]), 0
    for k, (z, torque) in enumerate(blocks):
        rows, torques = map(np.concatenate, zip(*(block for i, block in enumerate(blocks) if i != k)))
        beta = weighted_least_squares(rows, torques, free, start, 1.0)[0]
        squares += np.sum((torque - z @ beta) ** 2, axis=0)
        count += len(torque)
    return np.maximum(np.sqrt(squares / count), 1e-300)
