"""Coloured disturbance torques: an Ornstein-Uhlenbeck process e a joint, in the normal equations of a motion.

    e[k+1] = exp(-dt / T) e[k] + w[k],    w of variance s^2 (1 - exp(-2 dt / T)),    e[0] of variance s^2

(Uhlenbeck and Ornstein, Phys. Rev. 36, 1930). e is the coloured part of the torque reading's error, minus the torque
that disturbs the joint.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.likelihood.noise import Noise
from estimator.model import Mechanism
from estimator.numerics import BlockTridiagonal
from estimator.signals import causal

OFF = 1e-3
"""Level at a joint without a disturbance, as a share of its white noise: so small, and the equations stay definite."""

CONFIGURATIONS = 500
"""Samples, evenly taken, over which a function of the configuration is averaged."""


class Process(NamedTuple):
    """The process of n joints on one grid."""

    decay: FloatArray
    """(n,) exp(-dt / T)"""
    step: FloatArray
    """(n,) variance of w [N^2 m^2]"""
    first: FloatArray
    """(n,) variance of e[0] [N^2 m^2]"""

    @classmethod
    def of(cls, noise: Noise, dt: float) -> Process:
        """Process of `noise`, sampled every `dt` [s]."""
        variance = np.maximum(noise.disturbance, OFF * noise.torque) ** 2
        return cls(np.exp(-dt / noise.time_constant), variance * -np.expm1(-2.0 * dt / noise.time_constant), variance)

    def squares(self, e: FloatArray, ends: NDArray[np.int64]) -> FloatArray:
        """(n,) weighted squares of e (N, n): of its steps, and of its first value in each segment up to `ends`."""
        steps = _within(ends)[:, None] * (e[1:] - self.decay * e[:-1])
        return np.asarray(np.sum(steps**2, axis=0) / self.step + np.sum(e[_begins(ends)] ** 2, axis=0) / self.first)

    def log_determinant(self, ends: NDArray[np.int64]) -> float:
        """log det of the covariance of all steps and first values."""
        count = ends.size
        return float(np.sum((ends[-1] - count) * np.log(self.step) + count * np.log(self.first)))

    def score(self, e: FloatArray, own: FloatArray, crossed: FloatArray, ends: NDArray[np.int64]
              ) -> tuple[FloatArray, FloatArray]:
        """(n,) derivatives of `squares` + `log_determinant`, in the mean, by the logarithms of the variance s^2 and of
        the time constant T.

        e (N, n) has variances `own` (N, n), and covariances `crossed` (N - 1, n) between neighbouring samples.
        """
        begin, within, count = _begins(ends), _within(ends)[:, None], ends.size
        square, product = e**2 + own, e[1:] * e[:-1] + crossed
        later, both, before = ((within * x).sum(axis=0) for x in (square[1:], product, square[:-1]))
        a, steps, first = self.decay, float(ends[-1] - count), square[begin].sum(axis=0) / self.first
        left = (later - 2.0 * a * both + a * a * before) / self.step
        by_decay = 2.0 * (a * before - both) / self.step + (left - steps) * 2.0 * a / -np.expm1(2.0 * np.log(a))
        return steps + count - left - first, by_decay * a * -np.log(a)

    def share(self, white: FloatArray) -> FloatArray:
        """(n,) tr(C (C + white I)^-1) / N: the process's share of a long record's degrees of freedom.

        `white` (n,) are variances of white noise. Mean over frequency of S / (S + white), S = step / |1 - a e^iw|^2.
        """
        a, q = self.decay, self.step
        return np.asarray(q / np.sqrt((q + white * (1.0 + a * a)) ** 2 - (2.0 * a * white) ** 2))

    def innovations(self, error: FloatArray, joint: int, white: float) -> FloatArray:
        """(N,) what one joint's torque `error` (N,) of one segment, the process and white noise of standard deviation
        `white`, has that its past does not predict.

        Their sum is (1 - a L) error = (1 - b L) innovation with lag L (Box and Jenkins, Time Series Analysis, 1970, on
        sums of processes); b and the innovation's variance s follow from b s = a white^2 and
        (1 + b^2) s = step + (1 + a^2) white^2.
        """
        a, w = float(self.decay[joint]), white**2
        half = 0.5 * (float(self.step[joint]) + w * (1.0 + a * a))
        b = a * w / (half + np.sqrt(half**2 - (a * w) ** 2))
        return causal(error, np.array([1.0, -a]), np.array([1.0, -b]))

    def draw(self, count: int, joint: int, rng: np.random.Generator) -> FloatArray:
        """(count,) one joint's process [N m]."""
        w = np.sqrt(self.step[joint]) * rng.normal(size=count)
        w[0] = np.sqrt(self.first[joint]) * rng.normal()
        return causal(w, np.ones(1), np.array([1.0, -self.decay[joint]]))

    def add(self, chain: BlockTridiagonal, e: FloatArray, ends: NDArray[np.int64], sign: float = 1.0) -> None:
        """Add the rows of all joints to the last n latents of `chain`, `sign` times."""
        begin, within, n = _begins(ends), _within(ends), e.shape[1]
        diagonal, lower, right = chain.diagonal, chain.lower, chain.right[:, :, 0]
        for j in range(n):
            k, a, weight, first = chain.block - n + j, self.decay[j], sign / self.step[j] * within, sign / self.first[j]
            steps = weight * (e[1:, j] - a * e[:-1, j])
            own, score = np.append(a * a * weight, 0.0), np.append(-a * steps, 0.0)
            own[1:] += weight
            score[1:] += steps
            own[begin] += first
            score[begin] += first * e[begin, j]
            diagonal[:, k, k] += own
            lower[:, k, k] -= a * weight
            right[:, k] += score


def expected_score(mechanism: Mechanism, q: FloatArray, beta: FloatArray, freedom: FloatArray) -> FloatArray:
    """(p,) what disturbances that move the joints add to the expected score at the true parameters beta (p,).

    A disturbance d acts, so the acceleration, and with it the regressor Z, correlates with it. With C the covariance of
    d and V that of all errors of the torque, Stein's identity (Ann. Stat. 9, 1981) gives

        E[Z_i' V^-1 d] = sum over joints j of freedom_j * mean over q of (dM/dbeta_i M^-1)_jj,   freedom = tr(C V^-1)

    up to what d does to later samples through the state. q is (N, n), `freedom` (n,). Without this the parameters
    shrink by `freedom` / N times the variance of the torque's errors over that of the torque.
    """
    q = q[:: max(1, len(q) // CONFIGURATIONS)]
    inverse = np.linalg.inv(mechanism.inertia_matrix(q, beta))
    return np.array([freedom @ np.einsum("kij,kji->ki", mechanism.inertia_matrix(q, one), inverse).mean(axis=0)
                     for one in np.eye(mechanism.p)])


def _begins(ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """First sample of each segment."""
    return np.concatenate([[0], ends[:-1]])


def _within(ends: NDArray[np.int64]) -> FloatArray:
    """(N - 1,) 1 between neighbouring samples of one segment, 0 between segments."""
    out = np.ones(int(ends[-1]) - 1)
    out[ends[:-1] - 1] = 0.0
    return out
