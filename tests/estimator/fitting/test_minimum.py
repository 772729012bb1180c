"""The minimum that mle reports for a leg with an IMU, against scipy on the same sum of squares written out plainly.

The short-record search has its own check in test_search.py, the paper's free latents in test_mle_free.py.
"""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import least_squares

from daq import Dataset
from estimator import FitOptions, fit
from estimator.likelihood import slack_of
from estimator.model import leg2
from tests.support.mujoco_leg import Leg, record

NOISE = {"torque_nm": 0.02, "passive_nm": 0.01, "encoder_rad": 2e-4, "gyro_radps": 0.005, "accel_mps2": 0.05}
LEG = Leg(coulomb=(0.0, 0.0))
MECHANISM = leg2(lever_arm=LEG.lever)
FREE = 7
GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)


def inertia(beta: np.ndarray) -> float:
    """The straight leg's about its pivot."""
    return float(beta[0] + beta[1] + 2.0 * beta[2])


def residuals(w: np.ndarray, run: Dataset, reference: float) -> np.ndarray:
    """Of latents q, v, u at the samples and beta1 to beta7: motion by scipy's Hermite spline, torque on ramps.

    Nothing drives the pivot but what the model gets wrong, whose density is one of acceleration: its rows count
    over the leg's inertia, against `reference`.
    """
    n = len(run)
    q, v, u = w[:-FREE].reshape(3, n, 2)
    beta = np.concatenate([w[-FREE:], np.zeros(2)])
    spline = CubicHermiteSpline(run.time_s, q, v)
    pivot = 0.01 * inertia(beta) / reference
    out = []
    for share in GAUSS:
        at = run.time_s[:-1] + share * np.diff(run.time_s)
        needed = MECHANISM.inverse_dynamics(spline(at), spline(at, 1), spline(at, 2), beta)
        out.append((needed - (1.0 - share) * u[:-1] - share * u[1:]) / (slack_of(MECHANISM) * np.array([pivot, 0.02])))
    qdd = MECHANISM.forward_dynamics(q, v, u, beta)[:, 0]
    out += [u[:, 0] / pivot, (u[:, 1] - run["tau2_nm"]) / 0.02, (q[:, 1] - run["q2_rad"]) / 2e-4,
            (v[:, 0] - run["gyro_radps"]) / 0.005,
            (LEG.lever * qdd + 9.81 * np.sin(q[:, 0]) - run["accel_x_mps2"]) / 0.05,
            (-LEG.lever * v[:, 0] ** 2 - 9.81 * np.cos(q[:, 0]) - run["accel_y_mps2"]) / 0.05]
    return np.concatenate([part.ravel() for part in out])


def test_a_general_solver_finds_the_same_minimum() -> None:
    run = record(LEG, np.random.default_rng(4), seconds=6.0, high=4.0).part(slice(200, 270))
    found = fit([run], MECHANISM, FitOptions(noise=NOISE, fixed={"beta8": 0.0, "beta9": 0.0}))
    assert found.converged
    (path,) = found.trajectories
    at = np.concatenate([path.q.ravel(), path.qd.ravel(), path.tau.ravel(), found.beta[:FREE]])
    extra = (run, inertia(found.beta))
    value = float(np.sum(residuals(at, *extra) ** 2))
    start = at + np.concatenate([np.full(at.size - FREE, 1e-3), 0.05 * found.beta[:FREE]])
    assert np.sum(residuals(start, *extra) ** 2) > 2.0 * value
    check = least_squares(residuals, start, args=extra, x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert value == pytest.approx(2.0 * check.cost, rel=1e-6)
    assert np.all(np.abs(found.beta[:FREE] - check.x[-FREE:]) < 0.01 * found.std[:FREE])
