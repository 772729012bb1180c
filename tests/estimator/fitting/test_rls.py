"""Recursive least squares against the recursion as printed, and on an independent leg."""

import numpy as np
from numpy.testing import assert_allclose

from estimator import FitOptions, fit
from estimator.fitting.rls import recursive_estimates
from estimator.model import leg2
from tests.support.mujoco_leg import Leg, record


def printed_recursion(z, torque, variance, beta, covariance):
    """(64)-(67) sample by sample, with beta(t_{k-1}) in (64) and the transposes of (67)."""
    r, found = np.diag(variance), []
    for zk, yk in zip(z, torque):
        gain = covariance @ zk.T @ np.linalg.inv(zk @ covariance @ zk.T + r)
        beta = beta + gain @ (yk - zk @ beta)
        keep = np.eye(beta.size) - gain @ zk
        covariance = keep @ covariance @ keep.T + gain @ r @ gain.T
        found.append(beta)
    return np.array(found), covariance


def test_running_sums_are_the_printed_recursion() -> None:
    rng = np.random.default_rng(4)
    z = rng.normal(size=(80, 2, 5)) * np.array([1.0, 10.0, 0.1, 3.0, 1.0])
    truth = rng.normal(size=5)
    torque = z @ truth + rng.normal(size=(80, 2)) * np.array([0.01, 0.3])
    start, spread = rng.normal(size=5), np.diag(rng.uniform(0.5, 2.0, 5))
    variance = np.array([1e-4, 0.09])
    expected, covariance = printed_recursion(z, torque, variance, start, spread)
    found, last = recursive_estimates(z, torque, variance, start, spread)
    assert_allclose(found, expected, rtol=1e-7, atol=1e-9)
    assert_allclose(last, covariance, rtol=1e-6, atol=1e-12)


def test_a_fixed_parameter_stays() -> None:
    leg = Leg()
    run = record(leg, np.random.default_rng(3), seconds=10.0)
    result = fit([run], leg2(lever_arm=leg.lever), FitOptions(fixed={"beta8": 0.03}), "rls")
    assert result.beta[7] == 0.03
    assert result.std[7] == 0.0
