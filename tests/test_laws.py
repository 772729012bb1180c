"""Torque laws of effects in a simulation: their derivatives, and motion that they change."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.collocation import Motion
from estimator.effects import CLASSES
from estimator.effects.base import Effect
from estimator.effects.structure import RotorInertia
from estimator.extended import ExtendedProblem, Stage
from estimator.freerun import free_run
from estimator.gauss_newton import State
from estimator.latent import Latents, Noise
from estimator.laws import Laws
from estimator.mechanism import Mechanism, joint1, leg2
from estimator.signalset import SignalSet

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
