"""`NoiseScale`: channels that are noisier in one run than in another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from daq import FloatArray, IndexArray


@dataclass(frozen=True)
class NoiseScale:
    """Standard deviation of the noise at each of N samples over its channel's level; constant within a run."""

    torque: FloatArray
    """(N, n)"""
    encoder: FloatArray
    """(N, n)"""
    gyro: FloatArray
    """(S, N) of S IMUs"""
    accel: FloatArray
    """(S, N, 2)"""
    channels: frozenset[str] = frozenset()
    """Names of the channels in which runs differ."""

    def at(self, samples: slice | IndexArray) -> NoiseScale:
        """At some of the samples."""
        return NoiseScale(self.torque[samples], self.encoder[samples], self.gyro[:, samples], self.accel[:, samples],
                          self.channels)

    def by_kind(self) -> Iterator[tuple[str, FloatArray]]:
        """Kind of channel and its values."""
        yield from (("torque", self.torque), ("encoder", self.encoder), ("gyro", self.gyro), ("accel", self.accel))


def unit_scale(samples: int, joints: int, imus: int) -> NoiseScale:
    """All ones."""
    of_joints = samples, joints
    return NoiseScale(np.ones(of_joints), np.ones(of_joints), np.ones((imus, samples)), np.ones((imus, samples, 2)),
                      frozenset())
