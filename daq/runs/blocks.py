"""Means with a 95 % interval that holds for coloured noise: from the means of blocks of the record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.dataset import FloatArray

BLOCKS = 20
CONFIDENCE = 0.975
"""Of each side of a 95 % interval."""


@dataclass(frozen=True)
class Mean:
    """A mean, in the unit of its samples."""

    value: float
    half: float
    """Half of the 95 % interval."""
    drift: float
    """By how much a straight line through the record rises over its length."""
    drift_half: float

    @property
    def drifts(self) -> bool:
        """The record rises or falls for certain, and by more than the mean's interval."""
        return abs(self.drift) > max(self.drift_half, self.half)


def block_means(values: FloatArray) -> FloatArray:
    """(BLOCKS,) means of equal segments of `values` (n,), n at least BLOCKS; a remainder at the end is left out."""
    size = values.size // BLOCKS
    return values[: size * BLOCKS].reshape(BLOCKS, size).mean(axis=1)


def mean_of(values: FloatArray) -> Mean:
    """Mean of one record (n,), n at least `BLOCKS`, from its block means, which count as independent."""
    from scipy.special import stdtrit

    first = float(values[0])
    means = block_means(values - first)  # so that a reading that never changes has no spread by rounding
    middle, half = mean_interval(means)
    x = (np.arange(BLOCKS) - 0.5 * (BLOCKS - 1)) / BLOCKS
    slope = float(x @ means / (x @ x))
    left = means - middle - slope * x
    error = np.sqrt(left @ left / (BLOCKS - 2) / (x @ x))
    return Mean(first + float(np.mean(values - first)), half, slope, float(stdtrit(BLOCKS - 2, CONFIDENCE) * error))


def mean_interval(values: FloatArray) -> tuple[float, float]:
    """(mean, half of its 95 % interval) of independent values (n,), n at least 2."""
    return float(values.mean()), float(quantile(values.size - 1) * values.std(ddof=1) / np.sqrt(values.size))


def quantile(freedom: int) -> float:
    """Student's t at 97.5 %: what a standard error is multiplied with for half of a 95 % interval."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, CONFIDENCE))
