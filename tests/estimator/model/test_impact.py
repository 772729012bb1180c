"""The impact map of a walker, against one in extended coordinates, MuJoCo's engine, and what cannot change."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimator.model import biped3, land
from studies.walker import CONSTRAINT_TANGENT, IMPACT_RAD, TORSO_RAD, impact, true_parameters
from tests.support.walker_plant import Plant, Walker, random_walker

IN_HIPS = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 1.0], [0.0, -1.0, 1.0]])
"""Torso, torso against the leg that stands and against the one that swings, from their angles from upright."""


@pytest.mark.parametrize("seed", range(5))
def test_it_is_that_of_the_extended_coordinates(seed: int) -> None:
    rng = np.random.default_rng(seed)
    walker = random_walker(rng)
    angle, rate = rng.uniform(-0.6, 0.6, 3), rng.normal(size=3)
    q, qd = land(biped3(hips=True), walker.beta, IN_HIPS @ angle, IN_HIPS @ rate)
    after = Plant(walker).land(angle, rate)
    assert_allclose(q, IN_HIPS @ angle[[1, 0, 2]], atol=1e-14)
    assert_allclose(qd, IN_HIPS @ after[[1, 0, 2]], atol=1e-12)


def test_it_is_the_printed_one_in_the_papers_angles() -> None:
    q = np.array([IMPACT_RAD, np.pi - 2 * IMPACT_RAD, TORSO_RAD - IMPACT_RAD])
    rate = 1.6 * CONSTRAINT_TANGENT
    wanted, wanted_rate = impact(rate)
    found, found_rate = land(biped3(), true_parameters(), q, rate)
    assert_allclose(found, wanted, atol=1e-14)
    assert_allclose(found_rate, wanted_rate, atol=1e-12)


def test_mujoco_lands_the_same_way() -> None:
    """The walker afloat, its feet's places as coordinates; a landing is the constraint that the foot has no speed."""
    walker = Walker()
    r, a = walker.leg_m, walker.centre_m

    def leg(name: str) -> str:
        return (f'<body><joint name="{name}" type="hinge" axis="0 1 0"/><inertial pos="0 0 {a - r}" '
                f'mass="{walker.leg_kg}" diaginertia="1 {walker.leg_inertia} 1"/>'
                f'<site name="{name}" pos="0 0 {-r}"/></body>')

    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
        f'<inertial pos="0 0 0" mass="{walker.hip_kg}" diaginertia="1e-9 1e-9 1e-9"/>{leg("one")}{leg("two")}<body>'
        f'<joint type="hinge" axis="0 1 0"/><inertial pos="0 0 {walker.torso_m}" mass="{walker.torso_kg}" '
        f'diaginertia="1 {walker.torso_inertia} 1"/></body></body></worldbody></mujoco>')
    data = mujoco.MjData(model)
    angle, rate = np.array([0.35, -0.4, 0.5]), np.array([1.5, -0.4, 0.2])
    data.qpos[2:] = angle
    data.qvel[:] = [r * np.cos(angle[0]) * rate[0], -r * np.sin(angle[0]) * rate[0], *rate]  # the first foot stands
    mujoco.mj_forward(model, data)
    inertia, jacobian = np.zeros((5, 5)), np.zeros((3, 5))
    mujoco.mj_fullM(model, data, inertia)
    mujoco.mj_jacSite(model, data, jacobian, None, model.site("one").id)
    assert np.abs(jacobian @ data.qvel).max() < 1e-12
    mujoco.mj_jacSite(model, data, jacobian, None, model.site("two").id)
    foot = jacobian[[0, 2]]
    solved = np.linalg.solve(np.block([[inertia, -foot.T], [foot, np.zeros((2, 2))]]),
                             np.append(inertia @ data.qvel, [0.0, 0.0]))
    _, found = land(biped3(hips=True), walker.beta, IN_HIPS @ angle, IN_HIPS @ rate)
    assert_allclose(found, IN_HIPS @ solved[2:5][[1, 0, 2]], atol=1e-9)


def test_an_impact_takes_energy_and_a_wrong_beta_lands_otherwise() -> None:
    mechanism, beta = biped3(hips=True), Walker().beta
    q, qd = IN_HIPS @ np.array([0.4, -0.4, 0.5]), IN_HIPS @ np.array([1.6, -0.4, 0.1])
    new, rate = land(mechanism, beta, q, qd)
    assert 0.3 < (rate @ mechanism.inertia_matrix(new, beta) @ rate) / (qd @ mechanism.inertia_matrix(q, beta) @ qd) < 1
    assert np.abs(land(mechanism, beta * np.array([1, 1, 1, 1, 1, 1.05, 1, 1]), q, qd)[1] - rate).max() > 1e-3
