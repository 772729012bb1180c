"""`effective_samples`: how much of each channel the latents took, so that what is left tells of its noise."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.likelihood.latent_problem import LatentProblem
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import Linearised


def effective_samples(problem: LatentProblem, point: Linearised, p_diagonal: FloatArray, noise: Noise
                      ) -> dict[str, FloatArray]:
    """Degrees of freedom that the latents took from each channel, gamma = sum J P J^T / sigma^2, by run (R, ...).

    `p_diagonal` (N, b, b) are the diagonal blocks of the latents' covariance. Torque samples count by the square of
    `torque_weight`: so much they say of the noise. The S gyros' are (R, S), the accelerometers' (R, S, 2, 2), both
    axes' products, those with each other where they are correlated.
    """
    n, s, starts = problem.n, problem.imu_count, problem.run_starts

    def by_run(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values, starts, axis=0))

    variance = np.einsum("kii->ki", p_diagonal)
    weight = problem.torque_weight(noise)
    scale = problem.torque_level(noise)
    angles = problem.angle_scale(noise)
    torque = variance[:, 2 * n : 3 * n]
    if problem.disturbed:
        both = np.einsum("kii->ki", p_diagonal[:, 2 * n : 3 * n, 3 * n :])
        torque = torque + variance[:, 3 * n :] + 2.0 * both
    found = {"torque": by_run(torque * (weight / scale) ** 2),
             "encoder": by_run(variance[:, :n] if angles is None else variance[:, :n] / angles**2) / noise.encoder**2}
    if noise.torque_correlation is not None:
        shares = weight / scale
        torques = p_diagonal[:, 2 * n : 3 * n, 2 * n : 3 * n]
        found["torque_products"] = by_run(shares[:, :, None] * torques * shares[:, None, :])
    for channel, slope in (point.extra.by_torque.items() if point.extra is not None else ()):
        j = channel.joint or 0
        u = 2 * n + j
        own = u if channel.kind == "torque" else j
        both = slope**2 * variance[:, u] + 2.0 * slope * p_diagonal[:, own, u]
        if channel.kind == "torque" and problem.disturbed:
            both = both + 2.0 * slope * p_diagonal[:, 3 * n + j, u]
        if channel.kind == "torque":
            both = both * (weight[:, j] / scale[:, j]) ** 2
        else:
            both = both / (noise.encoder[j] * (1.0 if noise.scale is None else noise.scale.encoder[:, j])) ** 2
        found[channel.kind][:, j] += by_run(both)
    if problem.has_imu:
        found["gyro"], found["accel"] = np.zeros((len(starts), s)), np.zeros((len(starts), s, 2, 2))
    for k, joints in enumerate(problem.turned_by):
        rates = np.sum([p_diagonal[:, n + i, n + j] for i in joints for j in joints], axis=0)
        rows = point.accel_rows[k]
        if noise.scale is not None:
            rates, rows = rates / noise.scale.gyro[k] ** 2, rows / noise.scale.accel[k][:, :, None]
        found["gyro"][:, k] = by_run(rates) / noise.gyro[k] ** 2
        spread, products = rows @ p_diagonal, found["accel"][:, k]
        for i in range(2):
            products[:, i, i] = by_run(np.einsum("kb,kb->k", spread[:, i], rows[:, i]))
        if noise.accel_correlation != 0.0:
            products[:, 0, 1] = products[:, 1, 0] = by_run(np.einsum("kb,kb->k", spread[:, 0], rows[:, 1]))
        products /= np.outer(noise.accel[k], noise.accel[k])
    return found
