"""Mechanisms against MuJoCo: inverse dynamics and the accelerometer's equations."""

import mujoco
import numpy as np
import pytest
from numpy.random import Generator, default_rng
from numpy.testing import assert_allclose

from estimator.model import Mechanism, biped3, chain, joint1, leg2
from estimator.signals import accelerometer
from tests.support.mujoco_leg import GRAVITY, Leg
from tests.support.mujoco_tree import random_tree


def motion(rng: Generator, joints: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return rng.uniform(-3, 3, (40, joints)), rng.normal(0, 3, (40, joints)), rng.normal(0, 20, (40, joints))


@pytest.mark.parametrize("parent, mechanism", [
    ((-1, 0), leg2()), ((-1, 0, 0), biped3(gravity_mps2=GRAVITY)), ((-1, 0, 1, 2, 3), chain(5))],
    ids=["leg", "walker", "chain"])
def test_inverse_dynamics_are_those_of_mujoco(parent: tuple[int, ...], mechanism: Mechanism) -> None:
    rng = default_rng(3)
    tree = random_tree(rng, parent, viscous=0.0, coulomb=0.0, upright=mechanism.name == "biped3")
    model = tree.model(1e-3, [])
    data, known = mujoco.MjData(model), []
    q, qd, qdd = motion(rng, tree.n)
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(q, qd, qdd):
        mujoco.mj_inverse(model, data)
        known.append(data.qfrc_inverse.copy())
    tau = mechanism.inverse_dynamics(q, qd, qdd, tree.beta(mechanism))
    assert_allclose(tau, known, atol=1e-9 * np.abs(known).max())


@pytest.mark.parametrize("mechanism", [leg2(), biped3(), chain(4), joint1()], ids=lambda m: m.name)
def test_forward_dynamics_undoes_inverse(mechanism: Mechanism) -> None:
    rng = default_rng(6)
    beta = np.array([2.0 if a.term == "inertia" and a.at[0] == a.at[-1] else 0.1 for a in mechanism.parameters])
    q, qd, qdd = motion(rng, mechanism.n)
    tau = mechanism.inverse_dynamics(q, qd, qdd, beta)
    assert_allclose(mechanism.forward_dynamics(q, qd, tau, beta), qdd, atol=1e-9)


def test_accelerometer_agrees_with_mujoco() -> None:
    leg = Leg()
    model = leg.model(1e-3)
    data = mujoco.MjData(model)
    rng = default_rng(7)
    for _ in range(20):
        data.qpos[:], data.qvel[:] = rng.uniform(-2, 2, 2), rng.normal(0, 3, 2)
        data.qfrc_applied[:] = rng.normal(0, 1, 2)
        mujoco.mj_forward(model, data)
        ax, ay = accelerometer(data.qpos[:1], data.qvel[:1], data.qacc[:1], leg.lever, GRAVITY)
        s = data.sensordata  # x forward, z up along the link, rotation about -y
        assert_allclose([ax[0], ay[0], data.qvel[0]], [s[0], -s[2], -s[4]], atol=1e-9)
