"""`floor_errors`: the error that noise alone leaves, from records that the model itself would have given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from daq import FloatArray
from estimator.errors import FitError
from estimator.free_runs import SmoothedRun, channel_names, rows_of
from estimator.likelihood import LatentProblem, Noise, free_run
from estimator.prediction.replicate import draw_disturbance, draw_replicate, simulate_run
from estimator.prediction.smoothing import smooth_under
from estimator.signals import SignalSet

ATTEMPTS = 10
"""Replicates, one after the other, until one does not diverge: their noise is drawn."""


class FloorNoise(NamedTuple):
    """Noise with which bootstrap replicates are drawn."""

    noise: Noise
    rest: FloatArray
    """(n,) share of the most that each joint's dry friction leaves open near rest"""
    repeated: FloatArray
    """(n,) share of each joint's coloured disturbance that is a function of the state: structure, which is not noise"""


def white_noise(noise: Noise) -> FloorNoise:
    """These noise levels, all white."""
    none = np.zeros(noise.torque.size)
    return FloorNoise(noise, none, none)


def floor_errors(smoothed_run: SmoothedRun, rng: np.random.Generator, horizons_s: Sequence[float],
                 problem_of: Callable[[Sequence[SignalSet]], LatentProblem], noise: FloorNoise | None = None
                 ) -> FloatArray:
    """(H, C, N) free-run errors of a parametric-bootstrap replicate of the run.

    The replicate has the model's motion and quantisers, and this `noise`, by default the levels of the run;
    `problem_of` gives the likelihood of its signals. Pieces start from the motion that would be fitted to it, whole
    segments from the true one. Raises `FitError` where the model's own simulation diverges.
    """
    noise = noise or white_noise(smoothed_run.state.noise)
    problem, state = smoothed_run.problem, replace(smoothed_run.state, noise=noise.noise)
    for _ in range(ATTEMPTS):
        disturbance = draw_disturbance(problem, state, noise.rest, rng)
        truth = simulate_run(problem, state, rng, disturbance)
        signals = draw_replicate(problem, state, smoothed_run.signals, rng, truth, disturbance)
        again = problem_of(signals)
        begin = state if np.isinf(horizons_s).all() else smooth_under(again, smoothed_run.state, near=True)
        drive = again.torque - problem.torque_readings(state.x, state.beta)
        found = [free_run(again, state if np.isinf(h) else begin, drive, h) for h in horizons_s]
        measured = _measured(again, truth.q, truth.v)
        errors = [rows_of(problem, f.v, f.readings) - measured for f in found if f is not None]
        if len(errors) == len(found):
            return np.stack(errors)
    raise FitError("the replicates diverge")


def _measured(problem: LatentProblem, q: FloatArray, v: FloatArray) -> FloatArray:
    """(C, N) as the replicate's sensors read; the true motion where it has none."""
    n = problem.n
    out = np.zeros((len(channel_names(problem)), problem.total))
    out[:n], out[n : 2 * n] = np.where(problem.has_encoder[:, None], problem.angles.T, q.T), v.T
    readings = list(problem.imu_readings().values())
    if readings:
        out[2 * n :] = readings
    return out
