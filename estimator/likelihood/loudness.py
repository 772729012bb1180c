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
    """(S, N) of S IMUs"""
    accel: FloatArray
    """(S, N, 2)"""

    def of(self, samples: slice | NDArray[np.intp]) -> Loudness:
        """Of some of the samples."""
        return Loudness(self.torque[samples], self.encoder[samples], self.gyro[:, samples], self.accel[:, samples])


def even(samples: int, joints: int, imus: int) -> Loudness:
    """All runs alike."""
    of_joints = samples, joints
    return Loudness(np.ones(of_joints), np.ones(of_joints), np.ones((imus, samples)), np.ones((imus, samples, 2)))
