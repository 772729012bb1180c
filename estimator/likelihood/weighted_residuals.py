"""`weighted_residuals_after`: residuals of a motion over their variances, for the score of whatever may be added.

The derivative of half the objective by the size of something that adds `d` is the sum of weighted residuals times d.
They serve hundreds of candidates without a row of the normal equations for any.
"""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.likelihood.gauss_rows import GaussRows
from estimator.likelihood.latent_problem import LatentProblem
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import Latents, Linearised, WeightedResiduals, of_channel
from estimator.model import invert
from estimator.signals import accelerometer_slopes, imu_channels, torque_of


def weighted_residuals_after(problem: LatentProblem, x: Latents, beta: FloatArray, noise: Noise, point: Linearised,
                             step: FloatArray) -> WeightedResiduals:
    """Those of the motion `step` (N, b) away from x, to first order; `point` is the problem at x, where beta (p,) are
    the mechanism's parameters."""
    m, c, left, extra = problem.mechanism, problem.collocation, problem.left, point.extra
    n = problem.n
    moved = c.motion(step[:, :n], step[:, n : 2 * n], left)  # features are linear in angles and rates
    rows = GaussRows(problem, x, beta, extra)
    torque = rows.residual - c.torque(step[:, 2 * n : 3 * n], left)
    torque += np.einsum("igfjk,fjgk->igk", rows.slopes, np.stack(moved))
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
