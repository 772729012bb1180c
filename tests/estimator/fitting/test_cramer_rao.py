"""The Cramer-Rao bound against the exact one of the study, which shares no code with it."""

import numpy as np
import pytest

from estimator.likelihood import Noise
from estimator.model import leg2
from studies.biped3 import CASES
from studies.biped3.bound import exact_bound
from studies.biped3.protocol import TORQUE_VARIANCE
from studies.biped3.study import truth
from studies.walker import motor_mechanism, one_step
from tests.support.cramer_rao import cramer_rao


@pytest.mark.parametrize("case", CASES)
def test_collocation_and_shooting_agree(case) -> None:
    step, mechanism = one_step().in_motor_angles(), motor_mechanism()
    sigma = np.sqrt(TORQUE_VARIANCE)
    noise = Noise(np.array([0.03, sigma, sigma]), np.array([np.sqrt(case.angle_variance), 1e-8, 1e-8]))
    found = cramer_rao(mechanism, truth(), step.q, step.qd, step.torque, 100.0, "zero", noise)
    exact = exact_bound(mechanism, truth(), step, case.angle_variance, TORQUE_VARIANCE)
    np.testing.assert_allclose(np.sqrt(np.diag(found)), np.sqrt(np.diag(exact)), rtol=0.02)


def test_more_noise_never_helps_and_an_imu_does() -> None:
    rng = np.random.default_rng(1)
    mechanism = leg2(lever_arm=0.2)
    beta = np.array([0.12, 0.025, 0.036, 0.45, 0.12, 0.02, 0.03, 0.03, 0.05])
    time = np.arange(300) / 100.0
    q = np.stack([0.4 * np.sin(3 * time), 0.7 * np.sin(5 * time + 1)], axis=-1)
    qd = np.stack([1.2 * np.cos(3 * time), 3.5 * np.cos(5 * time + 1)], axis=-1)
    qdd = np.stack([-3.6 * np.sin(3 * time), -17.5 * np.sin(5 * time + 1)], axis=-1)
    torque = mechanism.inverse_dynamics(q, qd, qdd, beta) + 0.0 * rng.normal(size=q.shape)

    def spread(torque_sigma: float, gyro: float = np.inf) -> np.ndarray:
        imus = int(np.isfinite(gyro))
        noise = Noise(np.array([0.02, torque_sigma]), np.array([1e-3, 1e-4]), np.full(imus, gyro),
                      np.full((imus, 2), 0.05))
        return np.diag(cramer_rao(mechanism, beta, q, qd, torque, 100.0, "linear", noise))

    assert np.all(spread(0.02) < spread(0.04))
    assert np.all(spread(0.02, gyro=0.005) < spread(0.02))
