"""What passes between a problem and its solver: what effects add at one point, and the normal equations there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Extra:
    """What effects add to the model at one point, and its derivative by their k sizes."""

    torque: FloatArray
    """(n, 2, K) torque that the motion needs beyond Z beta, at the Gauss points [N m]."""
    torque_at_samples: FloatArray
    """(n, N)"""
    readings: Mapping[str, FloatArray]
    """Channel (torque1, encoder2, gyro, accel_x, accel_y, ...) to what is added to its reading, (N,)."""
    torque_columns: FloatArray
    """(k, n, 2, K)"""
    sample_columns: FloatArray
    """(k, n, N)"""
    reading_columns: Mapping[str, FloatArray]
    """Channel to (k, N)."""
    slopes: FloatArray | None = None
    """(n, 5, n, 2, K) derivative of `torque` by the features of the motion, where it is known."""
    sample_slopes: FloatArray | None = None
    """(n, 5, n, N)"""
    by_torque: Mapping[str, FloatArray] = field(default_factory=dict)
    """Encoder or torque channel to the derivative (N,) of what is added to its reading by its joint's torque latent."""


@dataclass(frozen=True)
class Linearised:
    """Gauss-Newton normal equations at one point."""

    objective: float
    diagonal: FloatArray
    """(N, b, b)"""
    lower: FloatArray
    """(N-1, b, b)"""
    right: FloatArray
    """(N b, 1 + p) gradient by the latents, then border."""
    corner: FloatArray
    """(p, p)"""
    gradient_beta: FloatArray
    """(p,)"""
    accel_rows: FloatArray
    """(N, 2, b) unscaled accelerometer rows, none without an IMU."""
    accel_border: FloatArray
    """(N, 2, p) their derivative by beta."""
    residuals: dict[str, FloatArray]
    """Unscaled residuals by channel."""
    extra: Extra | None = None

    @property
    def gradient(self) -> FloatArray:
        """(N b,)"""
        return self.right[:, 0]

    @property
    def border(self) -> FloatArray:
        """(N b, p)"""
        return self.right[:, 1:]
