"""`draw_replicate`: records that a fitted model would have given, with its own noise and quantisers.

What a score is on average when nothing is wrong is not exactly zero: quantisers, the sampling of reversals and
the smoothing leave traces. They are measured on replicates and taken off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq import FloatArray
from estimator.errors import FitError
from estimator.likelihood import FreeRun, LatentProblem, Noise, Process, State, draw_stiction, free_run
from estimator.signals import SignalSet, encoder_of, imu_channels, imu_columns, input_by_law, quantum, torque_of


def simulate_run(problem: LatentProblem, state: State, rng: np.random.Generator,
                 disturbance: FloatArray | None = None) -> FreeRun:
    """Motion of the model under the torque in `state`; always the same where no joint is passive.

    `disturbance` (N, n) acts on passive joints. Joints that follow commands move as their loops make them, so both it
    and the noise of the torque act on them. Raises `FitError` where its simulation does not stay with the run.
    """
    drive = problem.motor_torque(state.x, state.beta)
    if problem.closed:
        drive = problem.torque.copy()
        for j in problem.mechanism.actuated:
            drive[:, j] += state.noise.torque[j] * rng.normal(size=problem.total)
            drive[:, j] += 0.0 if disturbance is None else disturbance[:, j]
    for j in problem.mechanism.passive:  # what the fit put there is what the model gets wrong
        drive[:, j] = state.noise.torque[j] * rng.normal(size=problem.total)
        drive[:, j] += 0.0 if disturbance is None else disturbance[:, j]
    run = free_run(problem, state, drive)
    if run is None:
        raise FitError("the fitted model's own simulation diverges")
    return run


def draw_replicate(problem: LatentProblem, state: State, signals: Sequence[SignalSet], rng: np.random.Generator,
             run: FreeRun | None = None, disturbance: FloatArray | None = None) -> list[SignalSet]:
    """One synthetic record for each segment in `signals` of `run`, by default a new one.

    `disturbance` (N, n) is what the torque readings of driven joints do not show. Angles fall on the grid of the real
    encoder where it shows one; the other noise is white at the levels found. Raises `FitError` as `simulate_run` does.
    """
    run = run or simulate_run(problem, state, rng, disturbance)
    hidden = np.zeros_like(problem.torque) if disturbance is None else disturbance
    out = []
    noise = state.noise
    for s, where in zip(signals, np.split(np.arange(problem.total), problem.ends[:-1])):
        angles = s.angles.copy()
        for j in map(int, np.flatnonzero(problem.has_encoder)):
            true = run.readings[encoder_of(j)][where]
            grid = quantum(s.angles[:, j])
            if grid > 0.0 and noise.encoder[j] < grid:
                angles[:, j] = np.round(true / grid) * grid
            else:
                angles[:, j] = true + noise.encoder[j] * rng.normal(size=true.shape)
        torque, draws = np.zeros_like(s.torque), np.zeros_like(s.torque)
        for j in problem.mechanism.actuated:
            draws[:, j] = rng.normal(size=len(where))
        if noise.torque_correlation is not None:
            draws = draws @ np.linalg.cholesky(noise.torque_correlation).T
        for j in problem.mechanism.actuated:
            if problem.closed and s.commands is not None:  # noise and disturbance have acted on the motion
                torque[:, j] = input_by_law(s.commands, j, angles[:, j], s.rate_hz)
                continue
            torque[:, j] = run.readings[torque_of(j)][where] + noise.torque[j] * draws[:, j] - hidden[where, j]
        imu = {}
        for k in range(problem.imu_count):
            for column, channel, drawn in zip(imu_columns(k), imu_channels(k), draw_imu(noise, len(where), rng, k)):
                imu[column] = run.readings[channel][where] + drawn
        out.append(replace(s, angles=angles, torque=torque, imu=imu))
    return out


def draw_disturbance(problem: LatentProblem, state: State, rest: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(N, n) torque that acts on the joints unmeasured [N m]: the coloured disturbance, and friction near rest.

    Of the most that friction leaves open there it is the share `rest` (n,); see `estimator.likelihood.dry_friction`.
    """
    noise, out = state.noise, draw_stiction(problem, state, rest, rng)
    if noise.disturbance.any():
        process, lengths = Process.of(noise, problem.dt), np.diff(problem.ends, prepend=0)
        for j in map(int, np.flatnonzero(noise.disturbance)):
            out[:, j] += np.concatenate([process.draw(int(count), j, rng) for count in lengths])
    return out


def draw_imu(noise: Noise, count: int, rng: np.random.Generator, imu: int = 0
             ) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Noise of an IMU's gyro, accelerometer x and y, (count,) each: white, both axes correlated as declared."""
    gyro, x, own = (rng.normal(size=count) for _ in range(3))
    y = noise.accel_correlation * x + np.sqrt(1.0 - noise.accel_correlation**2) * own
    return noise.gyro[imu] * gyro, noise.accel[imu, 0] * x, noise.accel[imu, 1] * y
