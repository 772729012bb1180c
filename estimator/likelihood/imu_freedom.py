"""`imu_freedom`: what the latents take of the IMUs' degrees of freedom."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import FloatArray
from estimator.likelihood.noise import Noise


def imu_freedom(covariance: FloatArray, accel_rows: FloatArray, turned_by: Sequence[Sequence[int]], noise: Noise
                ) -> dict[str, FloatArray]:
    """gyro (S,) and accel (S, 2, 2) of `LatentProblem.effective_samples`.

    From the latents' `covariance` (N, b, b) at each sample, the accelerometers' rows by the latents (S, N, 2, b), and
    the joints whose rates add up to what each gyro reads.
    """
    n = covariance.shape[1] // 3
    rates = [sum(covariance[:, n + i, n + j].sum() for i in joints for j in joints) for joints in turned_by]
    products = np.zeros((len(accel_rows), 2, 2))
    for own, a in zip(products, accel_rows):
        spread = a @ covariance
        own[0, 0], own[1, 1] = (np.vdot(spread[:, i], a[:, i]) for i in range(2))
        if noise.accel_correlation != 0.0:
            own[0, 1] = own[1, 0] = np.vdot(spread[:, 0], a[:, 1])
    return {"gyro": np.array(rates) / noise.gyro**2,
            "accel": products / (noise.accel[:, :, None] * noise.accel[:, None])}
