"""`torque_colour`: how far the torque residual of a right model is correlated, because the motion is estimated.

A motion that is estimated follows a part of the torque's noise, and the residual is the rest: slow where encoders alone
show the motion, nearly white where an accelerometer does. How slow depends on the noise levels. It is measured:
noise at the levels found goes through the equations of the motion, linear about the fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from daq import BoolArray, FloatArray
from estimator.fitting.excerpt import excerpt
from estimator.likelihood import GaussRows, LatentProblem, Linearised, Noise, Process, State
from estimator.numerics import BlockTridiagonal, correlate, eliminate
from estimator.result import RESIDUAL_LAGS
from estimator.signals import SignalSet

SAMPLES = 16_000
"""Of a record that are looked at, and of noise that are drawn at least, in LEAST_DRAWS to MOST_DRAWS records. (The mean
autocorrelation of so many white ones scatters by 0.008.)"""
LEAST_DRAWS, MOST_DRAWS = 2, 8
"""See SAMPLES."""


class _Drawn(NamedTuple):
    """Noise of D records, by channel."""

    torque: FloatArray
    """(N, n, D), of what acts unmeasured as well"""
    encoder: FloatArray
    """(N, n, D)"""
    gyro: FloatArray
    """(S, N, D)"""
    accel: FloatArray
    """(S, N, 2, D)"""
    unseen: FloatArray
    """(n, 2, K, D) at the Gauss points, of torque that no sample shows"""


def torque_colour(problem: LatentProblem, state: State, signals: Sequence[SignalSet]) -> FloatArray:
    """(n, RESIDUAL_LAGS) autocorrelation, at lags from 1 sample on, of a torque residual that is noise alone.

    Zero at passive joints. Of a joint with a coloured disturbance, of its residual's innovations. For a record
    whose noise is d, the motion moves by H^-1 J^T W d. Of long `signals` the first part of each is taken. Where H is
    singular all is zero, so that nothing is taken off.
    """
    if problem.total > SAMPLES:
        parts, where = excerpt(signals, SAMPLES)
        own = LatentProblem(parts, problem.mechanism, problem.collocation.hold)
        problem, state = (own.with_disturbance() if problem.disturbed else own), replace(
            state, x=state.x.of(where), noise=state.noise.at(where))
    draws, n = int(np.clip(-(-SAMPLES // problem.total), LEAST_DRAWS, MOST_DRAWS)), problem.n
    drawn = _draw(problem, state.noise, draws, np.random.default_rng(0))
    point = problem.motion_equations(state.x, state.beta, state.noise)
    rest, out = _at_rest(problem, state.noise), np.zeros((n, RESIDUAL_LAGS))
    try:
        moved = eliminate(_by_noise(problem, state, point, drawn)).solutions()
    except np.linalg.LinAlgError:
        return out
    for j in problem.mechanism.actuated:
        left = np.where(rest[:, j, None], np.nan, _innovations(problem, state.noise, drawn.torque[:, j]
                                                               - moved[:, 2 * n + j], j))
        for one in left.T:
            segments = np.split(one, problem.ends[:-1])
            out[j] += correlate(segments, segments, np.arange(1.0, RESIDUAL_LAGS + 1)) / draws
    return out


def _draw(problem: LatentProblem, noise: Noise, draws: int, rng: np.random.Generator) -> _Drawn:
    """Noise at the levels found; none of a joint without a motor, whose torque is known."""
    scale, driven, shape = noise.scale, list(problem.mechanism.actuated), (problem.total, problem.n, draws)
    white = rng.normal(size=shape)
    if noise.torque_correlation is not None:
        white = np.linalg.cholesky(noise.torque_correlation) @ white
    torque = np.zeros(shape)
    torque[:, driven] = (problem.torque_level(noise)[:, :, None] * white)[:, driven]
    if problem.disturbed:
        process, lengths = Process.of(noise, problem.dt), np.diff(problem.ends, prepend=0)
        for j in map(int, np.flatnonzero(noise.disturbance)):
            torque[:, j] += np.stack([np.concatenate([process.draw(int(count), j, rng) for count in lengths])
                                      for _ in range(draws)], axis=-1)
    spread = problem.angle_scale(noise)
    level = np.broadcast_to(np.where(problem.has_encoder, noise.encoder, 0.0), shape[:2])
    encoder = (level if spread is None else level * spread)[:, :, None] * rng.normal(size=shape)
    gyro = rng.normal(size=(problem.imu_count, problem.total, draws))
    accel = rng.normal(size=(problem.imu_count, problem.total, 2, draws))
    for k in range(problem.imu_count):
        gyro[k] *= np.reshape(np.sqrt(problem.gyro_variance(k, noise)), (-1, 1))
        accel[k] = np.linalg.cholesky(np.linalg.inv(noise.accel_precision(k))) @ accel[k]
        accel[k] *= 1.0 if scale is None else scale.accel[k][:, :, None]
    unseen = np.zeros((problem.n, 2, problem.left.size, draws))
    for j in map(int, np.flatnonzero(noise.unseen)):
        unseen[j] = noise.unseen[j] * rng.normal(size=unseen.shape[1:])
    return _Drawn(torque, encoder, gyro, accel, unseen)


def _by_noise(problem: LatentProblem, state: State, point: Linearised, drawn: _Drawn) -> BlockTridiagonal:
    """The equations of `point` with J^T W d of each record d on the right."""
    own, draws, noise = point.chain, drawn.torque.shape[-1], state.noise
    chain = BlockTridiagonal.zeros(problem.total, own.block, draws)
    chain.diagonal[:], chain.lower[:] = own.diagonal, own.lower
    variances = problem.torque_variance(noise)
    for channel, columns, variance in problem.channels(variances, noise):
        number = channel.joint or 0
        values = drawn.gyro[number] if channel.kind == "gyro" else getattr(drawn, channel.kind)[:, number]
        for column in columns:
            chain.right[:, column] += values / np.reshape(variance, (-1, 1))
    if noise.torque_correlation is not None:
        n, added = problem.n, noise.torque_precision(variances) @ drawn.torque
        for first in range(2 * n, own.block, n):
            chain.right[:, first : first + n] += added
    for k in range(problem.imu_count):
        scale = 1.0 if noise.scale is None else noise.scale.accel[k][:, :, None]
        weighted = noise.accel_precision(k) @ (drawn.accel[k] / scale) / scale
        chain.right[:] += point.accel_rows[k].swapaxes(1, 2) @ weighted
    if noise.unseen.any():
        rows = GaussRows(problem, state.x, state.beta[: problem.mechanism.p], point.extra)
        for j in map(int, np.flatnonzero(noise.unseen)):
            squared = problem.motion_weight(noise)[j] ** 2
            weighted = squared[:, None] * drawn.unseen[j]
            added = np.einsum("gki,gkd->kid", rows.of(j, slice(None)), weighted, optimize=True)
            chain.right[problem.left] += added[:, : own.block]
            chain.right[problem.left + 1] += added[:, own.block :]
    return chain


def _at_rest(problem: LatentProblem, noise: Noise) -> BoolArray:
    """(N, n) samples at which dry friction may balance more torque than the noise: the residual is open there."""
    rest = problem.stiction(noise)
    return np.zeros((problem.total, problem.n), bool) if rest is None else rest[:, 0] > problem.torque_level(noise) ** 2


def _innovations(problem: LatentProblem, noise: Noise, error: FloatArray, joint: int) -> FloatArray:
    """(N, D) what the past of one joint's torque errors (N, D) does not predict."""
    if not problem.disturbed or not noise.disturbance[joint]:
        return error
    process, white = Process.of(noise, problem.dt), float(noise.torque[joint])
    return np.concatenate([np.stack([process.innovations(one, joint, white) for one in part.T], axis=-1)
                           for part in np.split(error, problem.ends[:-1])])
