"""Other engines move the leg as the plant of `tests/support/timed_leg` does."""

import importlib

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support import engine_leg, servo_plants, timed_leg
from tests.support.mujoco_leg import random_leg
from tests.support.timed_leg import Timing

ERRORS = {"pinocchio": 1e-9, "bullet": 2e-2}
"""Largest difference of the gyro [rad/s]; Bullet integrates by Euler's rule, the others by that of Runge and Kutta."""


@pytest.mark.parametrize("name", ERRORS)
@pytest.mark.parametrize("loop", ["open", "pd"])
def test_an_engine_moves_the_leg_as_ours_does(name: str, loop: str) -> None:
    pytest.importorskip(engine_leg.MODULES[name], reason='not installed: pip install "legid[engines]"')
    timing, found = Timing(500.0, 2, loop=loop), []
    for make in (lambda leg, rng: engine_leg.record(name, leg, rng, timing, log_hz=250.0, seconds=2.0),
                 lambda leg, rng: timed_leg.record(leg, rng, timing, seconds=2.0)):
        rng = np.random.default_rng(7)
        found.append(make(random_leg(rng), rng))
    theirs, ours = found
    assert_allclose(theirs.time_s, ours.time_s)
    assert_allclose(theirs["gyro_radps"], ours["gyro_radps"], atol=ERRORS[name])


def test_a_missing_engine_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert engine_leg.missing() == ["pinocchio", "bullet"]


def test_a_log_may_lie_between_ticks() -> None:
    rng = np.random.default_rng(7)
    leg, timing = random_leg(rng), Timing(500.0)
    plan = timed_leg.planned(rng, timing, 1.0)
    rows = np.zeros((plan.size * 16, 7))
    run = timed_leg.logged(leg, rng, timing, rows, plan, noise=(0.0, 0.0, 0.0), log_hz=200.0)
    assert run.rate_hz == 200.0 and len(run) == 200
    assert_array_equal(run["tau2_nm"][:4], plan[[0, 2, 5, 7]])


@pytest.mark.parametrize("name", ["Pinocchio", "MuJoCo"])
def test_simulators_move_a_leg_behind_a_loop_alike(name: str) -> None:
    if name not in servo_plants.there():
        pytest.skip('not installed: pip install "legid[engines]"')
    loop, found = servo_plants.Loop(8.0, 0.1, 1.2, 500.0, 0.0125), []
    for plant in ("by hand", name):
        rng = np.random.default_rng(7)
        found.append(servo_plants.record(plant, random_leg(rng), loop, rng, log_hz=100.0, seconds=1.0, amplitude=0.7,
                                         high=2.0, name="run"))
    for angle in ("q1_rad", "q2_rad"):
        assert_allclose(found[1][angle], found[0][angle], atol=2e-3)
