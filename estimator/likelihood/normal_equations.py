"""Data between a problem and its solver: what effects add at one point, the normal equations and residuals there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from daq import BoolArray, FloatArray, IndexArray
from estimator.numerics import BlockTridiagonal
from estimator.signals import Channel


@dataclass(frozen=True)
class Latents:
    """Values at all N samples, each (N, n)."""

    q: FloatArray
    v: FloatArray
    u: FloatArray
    """Torque that acts on the joint, a coloured disturbance included."""
    e: FloatArray | None = None
    """Coloured error of the torque reading, minus the disturbance: y = u + e + white noise. None without one."""

    def moved(self, step: FloatArray) -> Latents:
        """Shifted by step (N, b) in the order q, v, u, e."""
        n = self.q.shape[1]
        q, v, u, *e = (step[:, k : k + n] for k in range(0, step.shape[1], n))
        return Latents(self.q + q, self.v + v, self.u + u, None if self.e is None else self.e + e[0])

    def of(self, where: slice | IndexArray) -> Latents:
        """At some of the samples."""
        return Latents(self.q[where], self.v[where], self.u[where], None if self.e is None else self.e[where])


class Accumulators(NamedTuple):
    """Accumulators of normal equations."""

    chain: BlockTridiagonal
    square: FloatArray
    """(m, m) products of the right sides' columns, in the upper half at least."""
    misfit: FloatArray
    """(n,) sum of squares of each joint's equation of motion."""


class ReadingColumns(NamedTuple):
    """Derivatives of one channel's readings by those of the k sizes that change them."""

    which: IndexArray
    """(m,)"""
    values: FloatArray
    """(m, N)"""


@dataclass(frozen=True)
class Extra:
    """Contributions of effects to the model at one point, and their derivatives by the k sizes."""

    torque: FloatArray
    """(n, 2, K) torque that the motion needs beyond Z beta, at the Gauss points [N m]."""
    torque_at_samples: FloatArray
    """(n, N)"""
    readings: Mapping[Channel, FloatArray]
    """What is added to each, (N,)."""
    torque_columns: FloatArray
    """(k, n, 2, K)"""
    sample_columns: FloatArray
    """(k, n, N)"""
    acts: BoolArray
    """(k, n) whether `torque_columns` of a size have anything at a joint."""
    reading_columns: Mapping[Channel, ReadingColumns]
    slopes: FloatArray | None = None
    """(n, 5, n, 2, K) derivative of `torque` by the features of the motion, where it is known."""
    sample_slopes: FloatArray | None = None
    """(n, 5, n, N)"""
    by_torque: Mapping[Channel, FloatArray] = field(default_factory=dict)
    """Encoder or torque channel to the derivative (N,) of what is added to its reading by its joint's torque latent."""


@dataclass(frozen=True)
class Linearised:
    """Gauss-Newton normal equations at one point."""

    objective: float
    chain: BlockTridiagonal
    """Of the latents; its right sides are the gradient by the latents, then the border. Elimination uses it up."""
    corner: FloatArray
    """(p, p)"""
    gradient_beta: FloatArray
    """(p,)"""
    accel: FloatArray
    """(S, N, 2, b + 1 + p) unscaled accelerometer rows of S IMUs: by the latents, residual, by beta."""
    residuals: dict[str, FloatArray]
    """Unscaled residuals: torque (N, n), encoder (N, n), with a disturbance e (N, n), with IMUs gyro (S, N), accel
    (S, N, 2)."""
    extra: Extra | None = None

    @property
    def accel_rows(self) -> FloatArray:
        """(S, N, 2, b) accelerometer rows by the latents, a view."""
        return self.accel[..., : self.chain.block]


def add_reading(chain: BlockTridiagonal, columns: Sequence[int], weight: float | FloatArray, residual: FloatArray
                ) -> float:
    """Sum of weight times square of a sensor's residual (N,); its rows are added to `chain`.

    The sensor reads the sum of the latents `columns` at each sample; `weight` (N,) is one over its variance, or minus
    that where rows are taken away.
    """
    weighted = weight * residual
    for column in columns:
        chain.right[:, column, 0] += weighted
        for other in columns:
            chain.diagonal[:, column, other] += weight
    return float(residual @ weighted)


def of_channel(residuals: Mapping[str, FloatArray], channel: Channel) -> FloatArray:
    """(N,) of a torque, encoder or gyro channel, a view."""
    found, number = residuals[channel.kind], channel.joint or 0
    return found[number] if channel.kind == "gyro" else found[:, number]
