"""A block tridiagonal chain as one matrix, and what a smoother leaves in a residual by it."""

import numpy as np

from daq import Dataset, FloatArray
from estimator import RESIDUAL_LAGS
from estimator.likelihood import LatentProblem, Latents, Noise, State
from estimator.numerics import BlockTridiagonal


def residual_colour(problem: LatentProblem, state: State, std: float) -> np.ndarray:
    """Autocorrelation of y - y_hat of the knee's torque, whose sensor has `std`: of R - H P H^T (Rauch, Tung, Striebel,
    AIAA J. 3, 1965)."""
    covariance = np.linalg.inv(dense(problem.motion_equations(state.x, state.beta, state.noise).chain))
    of_knee = 2 * problem.n + 1 + problem.block * np.arange(problem.total)
    left = std**2 * np.eye(problem.total) - covariance[np.ix_(of_knee, of_knee)]
    return np.array([np.trace(left, k) for k in range(1, RESIDUAL_LAGS + 1)]) / np.trace(left)


def at_measured(problem: LatentProblem, data: Dataset, beta: np.ndarray, noise: Noise) -> State:
    """The motion as the encoders read it, without dry friction."""
    q = np.stack([data["q1_rad"], data["q2_rad"]], axis=-1)
    smooth = np.concatenate([beta[:7], np.zeros(2)])
    return State(Latents(q, np.gradient(q, 0.01, axis=0), problem.torque.copy()), smooth, noise, np.zeros((9, 9)))


def dense(chain: BlockTridiagonal) -> FloatArray:
    """(N b, N b) of a chain."""
    count, b, _ = chain.diagonal.shape
    out = np.zeros((count, b, count, b))
    for k in range(count):
        out[k, :, k] = chain.diagonal[k]
    for k in range(count - 1):
        out[k + 1, :, k], out[k, :, k + 1] = chain.lower[k], chain.lower[k].T
    return out.reshape(count * b, count * b)
