"""The emulated leg against MuJoCo, conservation of energy and textbook special cases."""

import math
from dataclasses import fields

import mujoco
import numpy as np
import pytest

from experiments.emulation import LegBody
from experiments.emulation.plant import LegPlant, LegState
from tests.support.mujoco_leg import Leg

FREE = LegBody(viscous=(0.0, 0.0), coulomb=(0.0, 0.0))


def energy(plant: LegPlant) -> float:
    """Kinetic plus potential energy [J], zero at rest hanging straight down."""
    b, s = plant.body, plant.state
    w2 = s.q1d + s.q2d
    com2_speed2 = (b.l1 * s.q1d) ** 2 + (b.c2 * w2) ** 2 + 2.0 * b.l1 * b.c2 * s.q1d * w2 * math.cos(s.q2)
    kinetic = 0.5 * ((b.i1 + b.m1 * b.c1**2) * s.q1d**2 + b.i2 * w2**2 + b.m2 * com2_speed2 + b.rotor * s.q2d**2)
    height1 = b.c1 * (1.0 - math.cos(s.q1))
    height2 = b.l1 * (1.0 - math.cos(s.q1)) + b.c2 * (1.0 - math.cos(s.q1 + s.q2))
    return kinetic + b.gravity * (b.m1 * height1 + b.m2 * height2)


def test_knee_torque_does_its_work() -> None:
    plant, work = LegPlant(FREE, q=(0.2, 0.1)), 0.0
    before = energy(plant)
    for k in range(4000):
        torque = 0.6 * math.sin(3e-3 * k)
        a = plant.state.q2
        work += torque * (plant.step(5e-4, torque).q2 - a)
    assert energy(plant) - before == pytest.approx(work, rel=1e-9, abs=1e-9)


def test_small_swing_of_a_stiff_leg_has_the_pendulum_period() -> None:
    # A knee locked by friction makes the leg a compound pendulum: T = 2 pi sqrt(I / (m g l)).
    body = LegBody(viscous=(0.0, 0.0), coulomb=(0.0, 50.0))
    plant = LegPlant(body, q=(0.02, 0.0))
    inertia = (body.i1 + body.m1 * body.c1**2 + body.i2 + body.m2 * (body.l1 + body.c2) ** 2)
    stiffness = body.gravity * (body.m1 * body.c1 + body.m2 * (body.l1 + body.c2))
    period = 2 * math.pi * math.sqrt(inertia / stiffness)
    times = []
    for _ in range(20000):
        before = plant.state.q1
        after = plant.step(1e-4, 0.0).q1
        if before > 0 >= after:
            times.append(plant.time_s - 1e-4 * after / (after - before))
    assert plant.state.q2 == 0.0
    assert times[1] - times[0] == pytest.approx(period, rel=1e-4)


def test_motion_agrees_with_mujoco() -> None:
    body = LegBody(coulomb=(0.0, 0.0))
    model = Leg(**{one.name: getattr(body, one.name) for one in fields(Leg) if hasattr(body, one.name)}).model(1e-4)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = (0.4, -0.9), (1.0, 0.5)
    plant = LegPlant(body, q=(0.4, -0.9), qd=(1.0, 0.5))
    for k in range(4000):
        torque = 0.8 * math.sin(0.004 * k)
        data.qfrc_applied[1] = torque
        for _ in range(5):
            mujoco.mj_step(model, data)
        state = plant.step(5e-4, torque)
    assert state[:4] == pytest.approx([*data.qpos, *data.qvel], abs=2e-6)


def hang(torque: float, coulomb: tuple[float, float]) -> LegState:
    plant = LegPlant(LegBody(coulomb=coulomb))
    for _ in range(200):
        state = plant.step(5e-4, torque)
    return state


def test_friction_holds_below_its_level_and_yields_above() -> None:
    assert hang(0.039, (0.04, 0.04))[:4] == (0.0, 0.0, 0.0, 0.0)
    held = hang(0.06, (0.5, 0.04))
    assert held.q1 == 0.0
    assert held.q2 > 0.0
    both = hang(0.2, (0.01, 0.04))
    assert both.q1 < 0.0 < both.q2  # the free pivot is pushed the other way


def test_swing_comes_to_rest_within_the_friction_cone() -> None:
    body = LegBody(viscous=(0.05, 0.05), coulomb=(0.05, 0.05))
    plant = LegPlant(body, q=(0.8, 0.3))
    for _ in range(30000):
        state = plant.step(5e-4, 0.0)
    assert state[2:] == (0.0, 0.0, 0.0, 0.0)
    beta = body.beta()
    knee = beta[4] * body.gravity * math.sin(state.q1 + state.q2)
    pivot = knee + beta[3] * body.gravity * math.sin(state.q1)
    assert abs(knee) <= 0.05 and abs(pivot) <= 0.05
    assert (abs(state.q1), abs(state.q2)) != (0.0, 0.0)


def test_large_steps_are_divided() -> None:
    coarse, fine = LegPlant(q=(0.5, 0.2)), LegPlant(q=(0.5, 0.2))
    coarse.step(0.01, 0.1)
    for _ in range(20):
        fine.step(5e-4, 0.1)
    assert coarse.state == pytest.approx(fine.state, abs=1e-12)


def test_hidden_torque_enters_the_joint_it_names() -> None:
    plant = LegPlant(FREE, hidden=[lambda time_s, motion, torque: (0.0, 0.3)])
    same = LegPlant(FREE)
    assert plant.step(1e-3, 0.0) == pytest.approx(same.step(1e-3, 0.3), abs=1e-15)


def test_closed_form_parameters_are_those_of_a_hand_count() -> None:
    beta = np.array(LegBody(m1=1, l1=2, c1=1, i1=0.5, m2=3, c2=0.5, i2=0.25).beta())
    assert beta[:5] == pytest.approx([0.5 + 1 + 12, 0.25 + 0.75, 3.0, 1 + 6, 1.5])
