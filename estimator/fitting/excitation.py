"""Combinations of parameters that the motion of a record does not excite, whatever method fits it.

A direction of beta is seen through its part Z d of the regressor. Where that is no larger than what sensor noise
alone puts there, the data says nothing about the direction, however small the residual: at rest every column of Z is
noise, and a joint that is locked gives columns that are zero or copies of others. Noise's part is found by adding
more of it to the measurements and forming Z again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from daq import BoolArray, Dataset, FloatArray
from estimator.fitting.identifiability import LARGEST_STD, name_directions, plausible_sizes, uncertain_directions
from estimator.fitting.prior import combined, prior_at
from estimator.fitting.wls import design_rows, free_mask, weighted_least_squares
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.result import Combination
from estimator.signals import IMU_COLUMNS, SignalSet, imu_columns, quantum, split_signals, white_noise_level

DRAWS = 2
"""Times that noise is added; its part of Z is the mean over them."""
AMPLE = 10.0
"""Where every direction has so many times the power that it needs, noise added once is enough."""
LEAST_POWER, LEAST_POWER_MLE = 3.0, 1.5
"""Power of Z along a direction, in units of noise's own, below which the direction is not excited. At 3 a third of it
is noise, and least squares shrinks by as much. `mle` allows for noise and comes through to about 1.5 (legs with an
encoder, 10 s); below, it has ended far from the truth without knowing it. Noise alone is seen as 0.8 to 3."""
FLAT = 1e-7
"""Root mean square of Z [rad/s2, m/s2, rad/s or 1] that is nothing, where measurements carry no noise at all."""
ROUND_OFF = 1e-11
"""Share of a column's power that counts as noise in any case: sums of squares carry no more digits."""
FEW_VALUES = 8
"""An encoder that shows no more values than this stands still; its noise is its step's."""


def undetermined_by_design(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions,
                           least_power: float = LEAST_POWER) -> tuple[Combination, ...]:
    """Names of what differenced, filtered measurements leave open: not excited, or too uncertain by least squares.

    Raises `FitError` where there is nothing to make a regressor from.
    """
    signals = split_signals(datasets, mechanism, options)
    free, beta = free_mask(mechanism, options)
    if not free.any():
        return ()
    design = design_rows(signals, mechanism, options)
    beta, covariance, _ = weighted_least_squares(design.z, design.torque, free, beta, design.samples_per_dof)
    known = np.zeros_like(covariance)
    if options.prior:
        beta = combined(mechanism, options.prior, beta, covariance)
        known = prior_at(mechanism, options.prior, beta).information
        covariance = covariance @ np.linalg.inv(np.eye(len(known)) + known @ covariance)
    scale = plausible_sizes(mechanism, beta)
    flat = unexcited_directions(signals, mechanism, options, free, least_power, design.z) / scale[:, None]
    flat = np.linalg.qr(flat / np.linalg.norm(flat, axis=0))[0]
    values, vectors = np.linalg.eigh(flat.T @ (known * np.outer(scale, scale)) @ flat)
    flat = flat @ vectors[:, values < LARGEST_STD**-2]  # the others are known from elsewhere
    return name_directions(mechanism.names, np.hstack([flat, uncertain_directions(covariance, scale, free)]), scale)


def unexcited_directions(signals: Sequence[SignalSet], mechanism: Mechanism, options: FitOptions,
                         free: BoolArray, least_power: float, regressor: FloatArray) -> FloatArray:
    """(p, k) directions of beta along which `regressor` (m, n, p) has less than `least_power` times noise's power."""
    rng = np.random.default_rng(0)
    index = np.flatnonzero(free)
    z = regressor[:, :, index].reshape(-1, index.size)
    power, noise = z.T @ z, len(z) * FLAT**2 * np.eye(index.size)
    levels = [_levels(s, options) for s in signals]
    for draw in range(DRAWS):
        noisier = design_rows([_noisier(*pair, rng) for pair in zip(signals, levels)], mechanism, options).z
        more = noisier[:, :, index].reshape(-1, index.size) - z
        once = more.T @ more
        if draw == 0 and _ratios(power, noise + once)[0][0] > AMPLE * least_power:
            return np.zeros((free.size, 0))
        noise += once / DRAWS
    ratios, vectors = _ratios(power, noise)
    out = np.zeros((free.size, int(np.sum(ratios < least_power))))
    out[index] = vectors[:, ratios < least_power]
    return out


def _ratios(power: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ratios (p,) of power to noise, both (p, p), ascending, and the directions (p, p) that have them."""
    scale = 1.0 / np.sqrt(np.diag(power) + np.diag(noise))
    both = np.outer(scale, scale)
    root = np.linalg.cholesky(noise * both + ROUND_OFF * np.eye(scale.size))
    whitened = np.linalg.solve(root, np.linalg.solve(root, power * both).T)
    ratios, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
    vectors = np.linalg.solve(root.T, vectors)
    return ratios, scale[:, None] * vectors


def _levels(s: SignalSet, options: FitOptions) -> dict[int | str, float]:
    """Noise of each joint's encoder, by number, and of each IMU column: as declared, or as the measurements show."""
    found: dict[int | str, float] = {}
    for j in range(s.angles.shape[1]):
        if np.isfinite(s.angles[:, j]).all():
            declared = options.encoder_noise(j)
            found[j] = _level(s.angles[:, j]) if declared is None else declared
    for k in range(len(s.imu) // len(IMU_COLUMNS)):
        known = (options.gyro_noise(k), options.accel_noise(0, k), options.accel_noise(1, k))
        for name, declared in zip(imu_columns(k), known):
            found[name] = _level(s.imu[name]) if declared is None else declared
    return found


def _noisier(s: SignalSet, levels: Mapping[int | str, float], rng: np.random.Generator) -> SignalSet:
    """The segment with noise of these levels added once more."""
    angles, imu = s.angles.copy(), dict(s.imu)
    for place, level in levels.items():
        noise = level * rng.normal(size=len(angles))
        if isinstance(place, str):
            imu[place] = imu[place] + noise
        else:
            angles[:, place] += noise
    return replace(s, angles=angles, imu=imu)


def _level(x: FloatArray) -> float:
    values = np.unique(x)
    step = float(np.min(np.diff(values))) if 1 < values.size <= FEW_VALUES else quantum(values)
    return max(white_noise_level(x), step / np.sqrt(12.0))
