"""Torque laws of effects in a simulation: their derivatives, and motion that they change."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from estimator.collocation import Motion
from estimator.effects import CLASSES
from estimator.effects.base import Effect
from estimator.effects.structure import BaseCompliance, RotorInertia
from estimator.extended import ExtendedProblem, Stage
from estimator.freerun import free_run
from estimator.gauss_newton import State
from estimator.latent import Latents, Noise
from estimator.laws import Laws
from estimator.mechanism import Mechanism, joint1, leg2
from estimator.signalset import SignalSet
from tests.mujoco_leg import Leg

FloatArray = NDArray[np.float64]
REACH = np.array([[-1.0, 1.0], [-1.0, 1.0]])


def problem_of(mechanism: Mechanism, count: int, torque: np.ndarray, effects: list[Effect]) -> ExtendedProblem:
    grid = np.arange(count) / 100.0
    imu = {c: np.zeros(count) for c in ("gyro_radps", "accel_x_mps2", "accel_y_mps2")} if mechanism.n > 1 else {}
    signals = SignalSet("r", 100.0, grid, np.zeros((count, mechanism.n)), torque, imu)
    return ExtendedProblem([signals], mechanism, "linear", Stage((0,), (0.0,), (0.0,), REACH, 7.0), effects)


@pytest.mark.parametrize("kind", [c for c in CLASSES if c(1).instant], ids=lambda c: c.name)
def test_slopes_are_those_of_the_law(kind: type[Effect]) -> None:
    rng = np.random.default_rng(5)
    effect, count = kind(1), 40
    size = np.array([10.0 * s.scale for s in effect.sizes] + [s.grid[-1] for s in effect.shapes])
    problem = problem_of(leg2(lever_arm=0.2), count, rng.normal(size=(count, 2)), [effect])
    x = Latents(*(rng.normal(size=(count, 2)) for _ in range(3)))
    laws = Laws([(effect, size)], problem.view(x, np.array([0.14, 0.03, 0.05, 0.5, 0.15, 0.02, 0.03, 0.03, 0.06])), 3)
    motion, where = problem.collocation.motion(x.q, x.v, problem.left[3:23]), slice(0, 20)
    slopes = laws.slopes(motion, where)
    for feature, name in enumerate(Motion._fields):
        for joint in range(2):
            def moved(by: float, name: str = name, joint: int = joint) -> Motion:
                values = getattr(motion, name).copy()
                values[joint] += by
                return motion._replace(**{name: values})
            found = (laws.torque(moved(1e-6), where) - laws.torque(moved(-1e-6), where)) / 2e-6
            assert slopes[:, feature, joint] == pytest.approx(found, rel=2e-3, abs=1e-4 * np.abs(slopes).max())


def test_a_rotor_heavier_than_its_link_is_a_heavier_link() -> None:
    """(J + Jr) qdd = tau - ...: with Jr = 3 J the rotor's torque, found from the acceleration, would feel itself with
    a gain of three."""
    count = 300
    torque = 0.8 * np.sin(np.arange(count) * 0.05)[:, None]
    light = np.array([0.02, 0.1, 0.03, 0.05])
    heavy = light + np.array([0.06, 0.0, 0.0, 0.0])
    runs = []
    for beta, effects in ((np.append(light, 0.06), [RotorInertia(0)]), (heavy, [])):
        problem = problem_of(joint1(), count, torque, list(effects))
        still = np.zeros((count, 1))
        state = State(Latents(still, still, torque), beta, Noise(np.ones(1), np.ones(1)), np.eye(beta.size))
        run = free_run(problem, state, torque)
        assert run is not None
        runs.append(run)
    assert np.ptp(runs[0].q) > 1.0
    assert runs[0].q == pytest.approx(runs[1].q, abs=1e-7)


def swing(leg: Leg, stand: tuple[float, float, float], time: FloatArray, torque: FloatArray) -> FloatArray:
    """(N, 4) absolute angles and rates of both links of a leg on a stand of mass M = 1/stand[0] that swings sideways
    at stand[1] Hz with damping stand[2], by the Lagrangian

    L = A w1^2/2 + B w2^2/2 + C cos(th1 - th2) w1 w2 + x' (g1 cos th1 w1 + g2 cos th2 w2) + M x'^2/2
        + g (g1 cos th1 + g2 cos th2) - K x^2/2.
    """
    a, b, c, g1, g2 = leg.beta()[:5]
    mass, omega = 1.0 / stand[0], 2.0 * np.pi * stand[1]

    def slope(t: float, y: FloatArray) -> FloatArray:
        th1, th2, x, w1, w2, xd = y
        tau, knee = np.interp(t, time, torque), leg.viscous[1] * (w2 - w1)
        moments = [g1 * np.cos(th1), g2 * np.cos(th2)]
        coupled = c * np.cos(th1 - th2)
        inertia = np.array([[a, coupled, moments[0]], [coupled, b, moments[1]], [*moments, mass]])
        force = [-tau + knee - leg.viscous[0] * w1 - c * np.sin(th1 - th2) * w2**2 - 9.81 * g1 * np.sin(th1),
                 tau - knee + c * np.sin(th1 - th2) * w1**2 - 9.81 * g2 * np.sin(th2),
                 g1 * np.sin(th1) * w1**2 + g2 * np.sin(th2) * w2**2
                 - mass * (2.0 * stand[2] * omega * xd + omega**2 * x)]
        return np.concatenate([y[3:], np.linalg.solve(inertia, force)])

    found = solve_ivp(slope, (time[0], time[-1]), np.zeros(6), t_eval=time, rtol=1e-8, atol=1e-9, max_step=0.01)
    return np.asarray(found.y[[0, 1, 3, 4]].T)


def test_a_free_run_on_a_stand_near_its_resonance_settles() -> None:
    """Steps of its iteration that still moved by up to 20 mrad had been taken for settled: 61 mrad off."""
    leg, stand, time = Leg(), (0.19, 2.5, 0.08), np.arange(1000) / 100.0
    torque = sum(0.15 * np.sin(2 * np.pi * f * time + f) for f in (0.4, 1.1, 1.7, 2.6))
    th1, th2, w1, w2 = swing(leg, stand, time, torque).T
    q, v = np.stack([th1, th2 - th1], axis=-1), np.stack([w1, w2 - w1], axis=-1)
    tau = np.stack([np.zeros_like(torque), torque], axis=-1)
    problem = problem_of(leg2(lever_arm=leg.lever), len(time), tau, [BaseCompliance()])
    beta = np.concatenate([leg.beta()[:7], [0.0, 0.0], stand])
    noise = Noise(np.full(2, 0.01), np.full(2, 1e-3))
    found = free_run(problem, State(Latents(q, v, tau), beta, noise, np.zeros((12, 12))), tau)
    assert found is not None and np.abs(q).max() > 0.8
    assert found.q == pytest.approx(q, abs=5e-3)
