"""Mechanisms against MuJoCo: inverse dynamics and the accelerometer's equations."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from estimator.model import Mechanism, biped3, joint1, leg2
from estimator.model.chain import chain
from estimator.signals import accelerometer
from tests.support.mujoco_leg import GRAVITY, Leg


def mujoco_tree(parents: list[int], lengths: np.ndarray, centres: np.ndarray, masses: np.ndarray,
                inertias: np.ndarray, gravity: float, up: bool) -> mujoco.MjModel:
    """Planar tree of links on hinges about -y, hanging along -z (or standing along +z, angles reversed)."""
    sign = 1.0 if up else -1.0
    axis = "0 1 0" if up else "0 -1 0"
    children: dict[int, list[int]] = {i: [] for i in range(-1, len(parents))}
    for i, p in enumerate(parents):
        children[p].append(i)

    def body(i: int) -> str:
        at = 0.0 if parents[i] < 0 else sign * lengths[parents[i]]
        inner = "".join(body(k) for k in children[i])
        return (f'<body pos="0 0 {at}"><joint type="hinge" axis="{axis}"/><inertial pos="0 0 {sign * centres[i]}" '
                f'mass="{masses[i]}" diaginertia="{inertias[i]} {inertias[i]} {inertias[i]}"/>{inner}</body>')

    text = (f'<mujoco><option gravity="0 0 -{gravity}"/><worldbody>{"".join(body(i) for i in children[-1])}'
            "</worldbody></mujoco>")
    return mujoco.MjModel.from_xml_string(text)


def inverse(model: mujoco.MjModel, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    data = mujoco.MjData(model)
    out = np.empty_like(q)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], qd[k], qdd[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def motion(rng: np.random.Generator, joints: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return rng.uniform(-3, 3, (40, joints)), rng.normal(0, 3, (40, joints)), rng.normal(0, 20, (40, joints))


def frictionless(mechanism: Mechanism, rigid: np.ndarray) -> np.ndarray:
    beta = np.zeros(mechanism.p)
    beta[: rigid.size] = rigid
    return beta


def test_leg2_agrees_with_mujoco() -> None:
    leg = Leg(viscous=(0.0, 0.0), coulomb=(0.0, 0.0))
    q, qd, qdd = motion(np.random.default_rng(3), 2)
    model = mujoco_tree([-1, 0], np.array([leg.l1, 0]), np.array([leg.c1, leg.c2]), np.array([leg.m1, leg.m2]),
                        np.array([leg.i1, leg.i2]), GRAVITY, False)
    tau = leg2(gravity_mps2=GRAVITY).inverse_dynamics(q, qd, qdd, leg.beta())
    np.testing.assert_allclose(tau, inverse(model, q, qd, qdd), atol=1e-9)


def test_biped3_agrees_with_mujoco() -> None:
    # Grizzle et al. 2001 as (57): swing leg and torso both turn at the hip, angles relative to the stance leg
    l1, g = 1.0, 9.8
    m, c, inertia = np.array([5.0, 5.0, 25.0]), np.array([0.5, 0.5, 0.2]), np.array([1e-6, 1e-6, 1.5])
    beta = np.array([inertia[0] + l1**2 * (m[1] + m[2]) + c[0] ** 2 * m[0], inertia[1] + m[1] * c[1] ** 2,
                     inertia[2] + m[2] * c[2] ** 2, l1 * c[1] * m[1], l1 * c[2] * m[2],
                     g * (l1 * m[1] + l1 * m[2] + c[0] * m[0]), g * c[1] * m[1], g * c[2] * m[2]])
    q, qd, qdd = motion(np.random.default_rng(4), 3)
    model = mujoco_tree([-1, 0, 0], np.array([l1, 0, 0]), c, m, inertia, g, True)
    tau = biped3(gravity_mps2=g).inverse_dynamics(q, qd, qdd, beta)
    np.testing.assert_allclose(tau, inverse(model, q, qd, qdd), atol=1e-9 * np.max(np.abs(tau)))


def test_five_link_chain_agrees_with_mujoco() -> None:
    rng = np.random.default_rng(5)
    n = 5
    length, m, inertia = rng.uniform(0.2, 0.4, n), rng.uniform(0.5, 2, n), rng.uniform(0.005, 0.02, n)
    c = 0.5 * length
    model = mujoco_tree([-1, 0, 1, 2, 3], length, c, m, inertia, GRAVITY, False)
    beyond = np.array([m[i + 1:].sum() for i in range(n)])
    pairs = [inertia[i] + m[i] * c[i] ** 2 + beyond[i] * length[i] ** 2 for i in range(n)]
    pairs += [length[i] * (m[j] * c[j] + beyond[j] * length[j]) for i in range(n) for j in range(i + 1, n)]
    moments = [m[i] * c[i] + beyond[i] * length[i] for i in range(n)]
    mechanism = chain(n, gravity_mps2=GRAVITY)
    q, qd, qdd = motion(rng, n)
    tau = mechanism.inverse_dynamics(q, qd, qdd, frictionless(mechanism, np.array([*pairs, *moments])))
    np.testing.assert_allclose(tau, inverse(model, q, qd, qdd), atol=1e-9)


@pytest.mark.parametrize("mechanism", [leg2(), biped3(), chain(4), joint1()], ids=lambda m: m.name)
def test_forward_dynamics_undoes_inverse(mechanism: Mechanism) -> None:
    rng = np.random.default_rng(6)
    beta = np.array([2.0 if a.term == "inertia" and a.at[0] == a.at[-1] else 0.1 for a in mechanism.parameters])
    q, qd, qdd = motion(rng, mechanism.n)
    tau = mechanism.inverse_dynamics(q, qd, qdd, beta)
    np.testing.assert_allclose(mechanism.forward_dynamics(q, qd, tau, beta), qdd, atol=1e-9)


def test_accelerometer_agrees_with_mujoco() -> None:
    leg = Leg()
    model = leg.model(1e-3)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(7)
    for _ in range(20):
        data.qpos[:], data.qvel[:] = rng.uniform(-2, 2, 2), rng.normal(0, 3, 2)
        data.qfrc_applied[:] = rng.normal(0, 1, 2)
        mujoco.mj_forward(model, data)
        ax, ay = accelerometer(data.qpos[:1], data.qvel[:1], data.qacc[:1], leg.lever, GRAVITY)
        s = data.sensordata  # x forward, z up along the link, rotation about -y
        np.testing.assert_allclose([ax[0], ay[0], data.qvel[0]], [s[0], -s[2], -s[4]], atol=1e-9)
