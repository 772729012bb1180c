"""`BlockTridiagonal`: normal equations that couple each sample with the next, one array for elimination.

A sample's rows hold everything that elimination takes to it at once: its own block, the right sides, and the block
that couples it with the next sample; all padded to whole lines of the processor's cache.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq import FloatArray

LINE = 8
"""Doubles in a line of the processor's cache; parts of a row are padded with zeros to a multiple."""


def padded(count: int) -> int:
    """The next multiple of LINE."""
    return -(-count // LINE) * LINE


@dataclass(frozen=True)
class BlockTridiagonal:
    """A symmetric block tridiagonal matrix H of N blocks of size b, with right sides."""

    rows: FloatArray
    """(N, b, f): H[k, k] (b columns), right sides (width), zeros up to `edge`, H[k, k+1] (b), zeros up to f."""
    width: int
    """Number of right sides."""

    @classmethod
    def zeros(cls, count: int, block: int, width: int) -> BlockTridiagonal:
        """A chain of `count` blocks, all zero."""
        return cls(np.zeros((count, block, padded(padded(block + width) + block))), width)

    @classmethod
    def of(cls, diagonal: FloatArray, lower: FloatArray, right: FloatArray) -> BlockTridiagonal:
        """Matrix from blocks diagonal (N, b, b), lower (N-1, b, b) = H[k+1, k] and right sides (N b, width)."""
        n, b, _ = diagonal.shape
        chain = cls.zeros(n, b, right.shape[1])
        chain.diagonal[:] = diagonal
        chain.lower[:] = lower
        chain.right[:] = right.reshape(n, b, -1)
        return chain

    @property
    def block(self) -> int:
        """Block size b."""
        return int(self.rows.shape[1])

    @property
    def edge(self) -> int:
        """Column of a row where the block that couples with the next sample begins."""
        return padded(self.block + self.width)

    @property
    def diagonal(self) -> FloatArray:
        """(N, b, b), a view."""
        return self.rows[:, :, : self.block]

    @property
    def lower(self) -> FloatArray:
        """(N-1, b, b) H[k+1, k], a view."""
        return self.rows[:-1, :, self.edge : self.edge + self.block].swapaxes(1, 2)

    @property
    def right(self) -> FloatArray:
        """(N, b, width), a view."""
        return self.rows[:, :, self.block : self.block + self.width]

    def flat_right(self) -> FloatArray:
        """(N b, width) right sides as a matrix, a view."""
        return self.rows.reshape(-1, self.rows.shape[2])[:, self.block : self.block + self.width]
