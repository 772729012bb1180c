"""`WeightedResiduals`: residuals of a motion over their variances, for the score of whatever the model may add.

The derivative of half the objective by the size of something that adds `d` is the sum of weighted residuals times d.
They serve hundreds of candidates without a row of the normal equations for any.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from daq import FloatArray
from estimator.effects import Perturbation
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import Latents, Linearised
from estimator.likelihood.trajectory_likelihood import LatentProblem, of_channel
from estimator.model import invert
from estimator.signals import Channel, accelerometer_slopes, imu_channels, torque_of


@dataclass(frozen=True)
class WeightedResiduals:
    """Residuals over their variances, by the place at which a `Perturbation` adds to them."""

    torque: FloatArray
    """(n, 2, K) of the equation of motion at the Gauss points [1/(N m)]"""
    torque_at_samples: FloatArray
    """(n, N) of the accelerometer, by the torque that its acceleration misses"""
    readings: Mapping[Channel, FloatArray]
    """(N,) each"""

    def along(self, added: Perturbation) -> float:
        """Derivative of half the objective by the amount of what is `added`."""
        total = 0.0
        if added.torque is not None and added.torque_at_samples is not None:
            total = float(np.vdot(self.torque, added.torque) + np.vdot(self.torque_at_samples, added.torque_at_samples))
        return total + sum(float(self.readings[channel] @ values) for channel, values in added.readings.items()
                           if channel in self.readings)


def weighted_residuals_after(problem: LatentProblem, x: Latents, beta: FloatArray, noise: Noise, point: Linearised,
                             step: FloatArray) -> WeightedResiduals:
    """Those of the motion `step` (N, b) away from x, to first order; `point` is the problem at x, where beta (p,) are
    the mechanism's parameters."""
    m, c, left, extra = problem.mechanism, problem.collocation, problem.left, point.extra
    n = problem.n
    moved = c.motion(step[:, :n], step[:, n : 2 * n], left)  # features are linear in angles and rates
    z, own = c.fast(*c.motion(x.q, x.v, left), beta)
    torque = (beta @ z.reshape(len(beta), -1)).reshape(z.shape[1:]) - c.torque(x.u + step[:, 2 * n : 3 * n], left)
    if problem.between is not None:
        torque -= problem.between
    if extra is not None:
        torque += extra.torque
        if extra.slopes is not None:
            own += extra.slopes.transpose(0, 3, 1, 2, 4)
    torque += np.einsum("igfjk,fjgk->igk", own, np.stack(moved))
    torque *= problem.motion_weight(noise)[:, None] ** 2
    residuals = problem.residuals_after(point, step, np.zeros(0), np.zeros(0, dtype=np.intp))
    variances = problem.torque_variance(noise)
    readings = {channel: of_channel(residuals, channel) / variance
                for channel, _, variance in problem.channels(variances, noise)}
    if noise.torque_correlation is not None:
        shared = np.einsum("kij,kj->ki", np.broadcast_to(noise.torque_precision(variances), (problem.total, n, n)),
                           residuals["torque"])
        readings |= {torque_of(j): shared[:, j] for j in range(n)}
    at_samples = np.zeros((n, problem.total))
    if problem.has_imu:
        q, v = (np.ascontiguousarray(part.T)[:, None] for part in (x.q, x.v))
        by_features = c.fast(q, v, np.zeros_like(v), v, v, beta)[1][:, 0]
        if extra is not None and extra.sample_slopes is not None:
            by_features += extra.sample_slopes
        inverse = invert(by_features)
        for k, place in enumerate(m.imus[: problem.imu_count]):
            accel = (residuals["accel"][k] @ noise.accel_precision(k)).T
            readings |= dict(zip(imu_channels(k)[1:], accel))
            felt = accelerometer_slopes(m, place, x.q.T, x.v.T, np.zeros_like(x.v.T))[3]
            at_samples -= np.einsum("rjN,jiN,rN->iN", felt, inverse, accel)
    return WeightedResiduals(torque, at_samples, readings)
