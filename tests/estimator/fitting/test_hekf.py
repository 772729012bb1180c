"""The filter's equations against numerical derivatives, and its estimates on the walker and an independent leg."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.linalg import expm

from daq import Dataset
from estimator import FitError, FitOptions, fit
from estimator.fitting import fit_each
from estimator.fitting.hekf import Filter, _advance_covariance
from estimator.model import leg2
from studies.biped3 import CASES
from studies.biped3.study import case_options, noisy_record, truth
from studies.walker import motor_mechanism, one_step
from tests.support.mujoco_leg import Leg, record

FREE = np.ones(9, dtype=bool)


def leg_filter(imu: bool) -> Filter:
    return Filter(leg2(lever_arm=0.2), FREE, 0.01, "linear", np.array([0.0, 4e-4]), np.full(4 if imu else 2, 1e-4),
                  (1,) if imu else (0, 1), imu)


def states(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = default_rng(seed)
    x = np.concatenate([rng.normal(size=(3, 4)), np.tile(Leg().beta(), (3, 1))], axis=1)
    return x, np.column_stack([np.zeros(3), rng.normal(size=3)])


@pytest.mark.parametrize("imu", [True, False])
def test_jacobians_are_the_derivatives(imu: bool) -> None:
    f = leg_filter(imu)
    x, u = states(1)
    slope, _ = f.slopes(x, u)
    _, h = f._measurement(x, u)
    for k in range(x.shape[1]):
        d = np.zeros(x.shape[1])
        d[k] = 1e-6
        assert_allclose(slope[..., k], (f.acceleration(x + d, u) - f.acceleration(x - d, u)) / 2e-6,
                        rtol=1e-5, atol=1e-5)
        both = [f._measurement(x + s * d, u)[0] for s in (1, -1)]
        assert_allclose(h[..., k], (both[0] - both[1]) / 2e-6, rtol=1e-5, atol=1e-5)


def test_covariance_follows_the_transposed_equation() -> None:
    # dP/dt = A P + P A^T + Q has the closed solution of Van Loan's block exponential
    rng = default_rng(2)
    a, q = rng.normal(size=(4, 4)), np.diag(rng.uniform(0.1, 1.0, 4))
    root = rng.normal(size=(4, 4))
    p0, t = root @ root.T, 0.05
    block = expm(np.block([[-a, q], [np.zeros((4, 4)), a.T]]) * t)
    flow = block[4:, 4:].T
    exact = flow @ p0 @ flow.T + flow @ block[:4, 4:]
    p = p0[None]
    for _ in range(20):
        p = _advance_covariance(a[None], q[None], p, t / 20)
    assert_allclose(p[0], exact, rtol=1e-9)
    assert_allclose(p[0], p[0].T, rtol=1e-12)


def walkers(case: int, seed: int, count: int) -> list[Dataset]:
    step = one_step().in_motor_angles()
    return [noisy_record(step, CASES[case], seed, run) for run in range(count)]


def test_walker_with_a_nearly_exact_angle_is_found() -> None:
    found = fit_each(walkers(0, 11, 6), motor_mechanism(), case_options(CASES[0]), "hekf")
    beta = np.array([outcome.beta for outcome in found if not isinstance(outcome, FitError)])
    assert len(beta) == 6
    assert_allclose(beta.mean(axis=0), truth(), rtol=0.1)


def test_records_together_are_records_alone() -> None:
    records = walkers(1, 12, 3)
    options = case_options(CASES[1])
    together = fit_each(records, motor_mechanism(), options, "hekf")
    for data, outcome in zip(records, together):
        assert not isinstance(outcome, FitError)
        alone = fit([data], motor_mechanism(), options, "hekf")
        assert_allclose(outcome.beta, alone.beta, rtol=1e-9)


def test_leg_with_imu_is_found() -> None:
    leg = Leg()
    run = record(leg, default_rng(3), seconds=4.0)
    result = fit([run], leg2(lever_arm=leg.lever), FitOptions(sensors="imu"), "hekf")
    assert_allclose(result.beta[:5], leg.beta()[:5], rtol=0.05)
    assert np.all(result.std > 0.0)


def test_failure_to_integrate_is_said() -> None:
    found = fit_each(walkers(2, 1, 20), motor_mechanism(), case_options(CASES[2]), "hekf")
    lost = [outcome for outcome in found if isinstance(outcome, FitError)]
    assert lost
    assert "failed to integrate" in str(lost[0])
