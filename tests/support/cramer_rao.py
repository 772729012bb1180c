"""The Cramer-Rao bound of a record: how well beta could be known from it by any unbiased estimator."""

import numpy as np

from daq import FloatArray
from estimator.likelihood import LatentProblem, Latents, Noise, State
from estimator.model import Mechanism
from estimator.score import score_at
from estimator.signals import SignalSet, imu_columns


def cramer_rao(mechanism: Mechanism, beta: FloatArray, q: FloatArray, qd: FloatArray, torque: FloatArray,
               rate_hz: float, hold: str, noise: Noise) -> FloatArray:
    """Smallest covariance (p, p) of beta (p,) on the true motion q, qd and torque (N, n) of one record.

    The inverse of `fisher_information`. Raises numpy.linalg.LinAlgError where the record leaves a direction of beta
    undetermined.
    """
    return inverse_information(fisher_information(mechanism, beta, q, qd, torque, rate_hz, hold, noise))


def fisher_information(mechanism: Mechanism, beta: FloatArray, q: FloatArray, qd: FloatArray, torque: FloatArray,
                       rate_hz: float, hold: str, noise: Noise) -> FloatArray:
    """Fisher information (p, p) of one segment about beta; that of several is their sum.

    Posed as `mle` poses it: the motion obeys the equation of motion, its states and the true torque are unknown
    and eliminated, encoders, torque and IMU carry white noise of the levels in `noise` (an encoder with an
    infinite level is not there, nor are IMUs without a level).
    """
    angles = np.where(np.isfinite(noise.encoder), q, np.nan)
    imu = {name: np.zeros(len(q)) for k in range(noise.gyro.size) for name in imu_columns(k)}
    signals = SignalSet("truth", rate_hz, np.arange(len(q)) / rate_hz, angles, torque, imu)
    problem = LatentProblem([signals], mechanism, hold)
    return score_at(problem, State(Latents(q, qd, torque), beta, noise, np.zeros((beta.size, beta.size)))).information


def inverse_information(information: FloatArray) -> FloatArray:
    """The covariance (p, p) that belongs to it. Raises numpy.linalg.LinAlgError where it is singular."""
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(0.5 * (information + information.T) * np.outer(scale, scale))
    return np.asarray(covariance * np.outer(scale, scale), dtype=np.float64)
