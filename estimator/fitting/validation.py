"""Free-run simulation held against a run that the fit has not seen (Table V of the paper)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from daq import Dataset, FloatArray
from estimator.fitting.smoothing import estimate_motion, reference_angles
from estimator.model import Mechanism, simulate
from estimator.options import FitOptions


@dataclass(frozen=True)
class Validation:
    """One gap-free stretch of one run: measured against simulated from its first state and torque alone."""

    run: str
    time_s: FloatArray
    """(N,)"""
    q: FloatArray
    """(N, n) simulated [rad]"""
    qd: FloatArray
    reference_q: FloatArray
    """(N, n) measured: encoders where the run has them, else smoothed from the IMU [rad]"""
    reference_qd: FloatArray
    sums: Mapping[str, float]
    """Summed squared errors: q1_rad, q2_rad [rad^2], q1d, q2d [rad^2/s^2] and so on by joint."""
    rmse: Mapping[str, float]
    horizon_s: float
    """How long the free run stayed within the range of floats."""
    diverged: bool


def validate(dataset: Dataset, mechanism: Mechanism, beta: FloatArray, options: FitOptions) -> list[Validation]:
    """Simulate each gap-free stretch of `dataset` from its estimated initial state under its measured torque.

    The initial state (angle and rate of every joint) is the smoothed estimate of the same model, from all
    sensors of the path in use. The reference angle of the pivot is its encoder's where the run has one (it is
    read here as a benchmark only), otherwise the smoothed estimate. Raises `FitError`.
    """
    out = []
    for motion in estimate_motion([dataset], mechanism, beta, options):
        dt = 1.0 / dataset.rate_hz
        q, qd, _ = simulate(mechanism, beta, motion.q[0], motion.qd[0], motion.tau_measured, dt, options.hold,
                            guess=(motion.q, motion.qd))
        reference = reference_angles(dataset, mechanism, motion)
        good = np.isfinite(q).all(axis=1)
        last = int(np.argmin(good)) if not good.all() else len(q)
        error, error_rate = q - reference, qd - motion.qd
        sums, rmse = {}, {}
        for j in range(mechanism.n):
            for name, e in ((f"q{j + 1}_{mechanism.length_unit}", error[:, j]), (f"q{j + 1}d", error_rate[:, j])):
                sums[name] = float(np.sum(e**2)) if good.all() else float("inf")
                rmse[name] = float(np.sqrt(np.mean(e[:last] ** 2))) if last else float("inf")
        out.append(Validation(motion.run, motion.time_s, q, qd, reference, motion.qd, sums, rmse, last * dt,
                              not bool(good.all())))
    return out
