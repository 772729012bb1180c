"""`BatchProblem`: the likelihood of `latent_problem` of many equally long records at once, each by its own beta.

Encoder path and known noise levels only. Records are laid end to end as one chain of blocks whose couplings
between records are zero, so that one elimination does for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from daq import FloatArray, IndexArray
from estimator.likelihood.assembly_numba import add_motion
from estimator.likelihood.measured_runs import slack_of
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import Accumulators, Latents, add_reading
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

    def pick(self, where: IndexArray) -> Records:
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
        n, c = self.n, self.collocation
        runs, samples, b = x.shape
        latents = Latents(*(np.ascontiguousarray(x[..., k : k + n]).reshape(-1, n) for k in range(0, b, n)))
        between = c.between(records.torque.reshape(-1, n), np.arange(1, runs + 1) * samples)
        weight = np.repeat(1.0 / (slack_of(self.mechanism) * self.noise.torque)[:, None], samples - 1, axis=1)
        width = 1 + self.mechanism.p  # right sides: residual, then parameters
        chain = BlockTridiagonal.zeros(runs * samples, b, width)
        square = np.zeros((runs, width, width))
        for r in range(runs):
            left = slice(r * samples, (r + 1) * samples - 1)
            intervals = slice(r * (samples - 1), (r + 1) * (samples - 1))
            accumulators = Accumulators(chain, square[r], np.zeros(n))
            add_motion(c, latents, beta[r], weight, intervals, left, None, accumulators, between)
        upper = np.triu(square)
        square = upper + np.triu(upper, 1).swapaxes(1, 2)
        objective = square[:, 0, 0] + self._sample_rows(records, latents, chain)
        if not np.isfinite(objective).all():
            raise np.linalg.LinAlgError("the motion left the range of floats")
        solved = eliminate(chain)
        half = chain.flat_right().reshape(runs, samples * b, width)
        products = half.swapaxes(1, 2) @ half
        reduced, found = square - products, solved.solutions().reshape(runs, samples, b, width)
        return Point(objective, -found[..., 0], products[:, 0, 0], -found[..., 1:], reduced[:, 1:, 1:],
                     reduced[:, 1:, 0])

    def _sample_rows(self, records: Records, x: Latents, chain: BlockTridiagonal) -> FloatArray:
        """Add torque and encoder samples; returns their part of the objective (R,)."""
        n, runs = self.n, len(records.angles)
        total = np.zeros(runs)
        spread = np.ones((1, n)) if records.spread is None else records.spread.reshape(-1, n)
        for j in range(n):
            for column, residual, variance in (
                    (j, x.q[:, j] - records.angles[..., j].ravel(), (self.noise.encoder[j] * spread[:, j]) ** 2),
                    (2 * n + j, x.u[:, j] - records.torque[..., j].ravel(), self.noise.torque[j] ** 2)):
                weight = 1.0 / variance
                add_reading(chain, (column,), weight, residual)
                total += (weight * residual**2).reshape(runs, -1).sum(axis=1)
        return total
