"""`Loudness`: channels that are noisier in one run than in another."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray


class Loudness(NamedTuple):
    """Standard deviation of the noise at each of N samples over its channel's level; constant within a run."""

    torque: FloatArray
    """(N, n)"""
    encoder: FloatArray
    """(N, n)"""
    gyro: FloatArray
    """(N,)"""
    accel: FloatArray
    """(N, 2)"""

    def of(self, samples: slice | NDArray[np.intp]) -> Loudness:
        """Of some of the samples."""
        return Loudness(*(of_kind[samples] for of_kind in self))


def even(samples: int, joints: int) -> Loudness:
    """All runs alike."""
    return Loudness(np.ones((samples, joints)), np.ones((samples, joints)), np.ones(samples), np.ones((samples, 2)))
