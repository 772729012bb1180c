"""The motion behind a run under given parameters: the likelihood's latent trajectory with beta held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from daq import Dataset, FloatArray
from estimator.fitting.mle import fit_mle
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.result import Trajectory
from estimator.signals import angle_column


def estimate_motion(datasets: Sequence[Dataset], mechanism: Mechanism, beta: NDArray[np.float64],
                    options: FitOptions) -> tuple[Trajectory, ...]:
    """Most likely motion of every gap-free stretch given beta (p,) and all sensors in use. Raises `FitError`."""
    held = {name: float(value) for name, value in zip(mechanism.names, beta)}
    return fit_mle(datasets, mechanism, replace(options, fixed=held, latent="trajectory")).trajectories


def reference_angles(data: Dataset, mechanism: Mechanism, motion: Trajectory) -> FloatArray:
    """(N, n) angles that a simulation of `motion`'s stretch is held against: as the encoders of `data` read, else as
    the motion has them."""
    rows, out = np.searchsorted(data.time_s, motion.time_s), motion.q.copy()
    for j in range(mechanism.n):
        column = angle_column(mechanism, j)
        if column in data:
            out[:, j] = np.where(np.isfinite(data[column][rows]), data[column][rows], out[:, j])
    return out
