"""`BatchProblem`: the likelihood of `trajectory_likelihood` of many equally long records at once, each by its own beta.

Encoder path and known noise levels only. Records are laid end to end as one chain of blocks whose couplings
between records are zero, so that one call does the work of all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.likelihood.noise import Noise
from estimator.likelihood.trajectory_likelihood import slack_of
from estimator.model import Collocation, Mechanism
from estimator.numerics import BlockTridiagonal, eliminate


class Point(NamedTuple):
    """Normal equations of R records at one place; latents in the order q, v, u of n joints, block b = 3 n."""

    objective: FloatArray
    """(R,) weighted sum of squares"""
    step: FloatArray
    """(R, N, b) Gauss-Newton step of the latents at fixed beta"""
    decrease: FloatArray
    """(R,) by which that step would lower the objective if it were quadratic"""
    by_beta: FloatArray
    """(R, N, b, p) derivative of the best latents by beta"""
    information: FloatArray
    """(R, p, p) of beta with the latents eliminated"""
    score: FloatArray
    """(R, p) half the gradient of the objective by beta with the latents eliminated"""


@dataclass(frozen=True)
class Records:
    """R records of N samples at the same times."""

    angles: FloatArray
    """(R, N, n) encoder angles [rad]"""
    torque: FloatArray
    """(R, N, n) measured torque, zero on a passive joint [N m]"""
    spread: FloatArray | None = None
    """(R, N, n) standard deviation of each angle over its channel's, where they differ"""

    def pick(self, where: NDArray[np.intp]) -> Records:
        """Some of the records."""
        return Records(self.angles[where], self.torque[where], None if self.spread is None else self.spread[where])


class BatchProblem:
    """Linearises and eliminates the latents; see the module's text."""

    def __init__(self, mechanism: Mechanism, rate_hz: float, hold: str, noise: Noise) -> None:
        self.mechanism, self.noise, self.n = mechanism, noise, mechanism.n
        self.collocation = Collocation(mechanism, 1.0 / rate_hz, hold)

    def linearise(self, records: Records, x: FloatArray, beta: FloatArray) -> Point:
        """At latents x (R, N, 3 n) and beta (R, p). Raises numpy.linalg.LinAlgError where it cannot be solved."""
        with np.errstate(over="ignore", invalid="ignore"):  # a trial that diverges has a large objective
            return self._linearise(records, x, beta)

    def _linearise(self, records: Records, x: FloatArray, beta: FloatArray) -> Point:
        m, n, c = self.mechanism, self.n, self.collocation
        runs, samples, b = x.shape
        left = np.delete(np.arange(runs * samples), np.s_[samples - 1 :: samples])
        count = left.size
        q, v, u = (x[..., k * n : (k + 1) * n].reshape(-1, n) for k in range(3))
        own = np.repeat(beta, samples - 1, axis=0).T  # (p, K)
        motion = c.motion(q, v, left)
        z_raw, slopes = c.terms(motion)
        z = c.to_joint(z_raw)  # (p, n, 2, K)
        defect = np.einsum("pK,pigK->igK", own, z) - c.torque(u, left)
        between = c.between(records.torque.reshape(-1, n), np.arange(1, runs + 1) * samples)
        if between is not None:
            defect -= between
        jac = c.jacobian(slopes, own, motion.angle.shape[1:])  # (n, 2, 4, n, K)
        rows = np.zeros((count, 2, n, 2, 3, n))  # Gauss point, joint; end of interval, variable, its joint
        rows[:, :, :, :, :2] = jac.reshape(n, 2, 2, 2, n, count).transpose(5, 1, 0, 2, 3, 4)
        for i in range(n):
            rows[:, :, i, :, 2, i] = -c.torque_weights
        scale = np.tile(1.0 / (slack_of(m) * self.noise.torque), 2)
        rows = rows.reshape(count, 2 * n, 2 * b) * scale[:, None]
        columns = np.empty((count, 2 * n, m.p + 1))  # by beta, then the residual itself
        columns[:, :, :-1] = z.transpose(3, 2, 1, 0).reshape(count, 2 * n, -1) * scale[:, None]
        columns[:, :, -1] = defect.transpose(2, 1, 0).reshape(count, 2 * n) * scale
        transposed = rows.swapaxes(1, 2)
        local = (transposed @ rows).reshape(runs, samples - 1, 2 * b, 2 * b)
        local_right = (transposed @ columns).reshape(runs, samples - 1, 2 * b, m.p + 1)
        tall = columns.reshape(runs, -1, m.p + 1)
        corner = tall.swapaxes(1, 2) @ tall  # (R, p + 1, p + 1), the last entry the defects' sum of squares

        diagonal = np.zeros((runs, samples, b, b))
        lower = np.zeros((runs, samples, b, b))
        right = np.zeros((runs, samples, b, m.p + 1))
        diagonal[:, :-1] = local[..., :b, :b]
        diagonal[:, 1:] += local[..., b:, b:]
        lower[:, :-1] = local[..., b:, :b]
        right[:, :-1] = local_right[..., :b, :]
        right[:, 1:] += local_right[..., b:, :]
        objective = corner[:, -1, -1] + self._sample_rows(records, x, diagonal, right)
        if not np.isfinite(objective).all():
            raise np.linalg.LinAlgError("the motion left the range of floats")
        chain = BlockTridiagonal.of(diagonal.reshape(-1, b, b), lower.reshape(-1, b, b)[:-1],
                                    right.reshape(-1, m.p + 1))
        solved = eliminate(chain).solutions().reshape(runs, samples * b, m.p + 1)
        flat = right.reshape(runs, samples * b, m.p + 1)
        reduced = corner - flat.swapaxes(1, 2) @ solved
        information = 0.5 * (reduced[:, :-1, :-1] + reduced[:, :-1, :-1].swapaxes(1, 2))
        decrease = np.einsum("rk,rk->r", flat[:, :, -1], solved[:, :, -1])
        shape = (runs, samples, b)
        return Point(objective, -solved[:, :, -1].reshape(shape), decrease,
                     -solved[:, :, :-1].reshape(*shape, m.p), information, reduced[:, :-1, -1])

    def _sample_rows(self, records: Records, x: FloatArray, diagonal: FloatArray, right: FloatArray) -> FloatArray:
        """Add torque and encoder samples; returns their part of the objective (R,)."""
        n = self.n
        sigma = np.concatenate([self.noise.encoder, np.full(n, np.inf), self.noise.torque])
        residual = x - np.concatenate([records.angles, x[..., n : 2 * n], records.torque], axis=-1)
        weight = np.broadcast_to(1.0 / sigma**2, x.shape)
        if records.spread is not None:
            weight = np.concatenate([weight[..., :n] / records.spread**2, weight[..., n:]], axis=-1)
        index = np.arange(3 * n)
        diagonal[..., index, index] += weight
        right[..., -1] += residual * weight
        total: FloatArray = np.einsum("rkb,rkb->r", residual**2, weight)
        return total
