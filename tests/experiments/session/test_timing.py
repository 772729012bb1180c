"""What a rig file states of its times, against a plant with times of its own."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import legid
from daq import parse_rig
from experiments.session import prepare, with_delay
from tests.support.mujoco_leg import random_leg
from tests.support.timed_leg import Timing, record

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = 0.2\n'


def test_a_stated_delay_moves_whole_samples_exactly() -> None:
    rng = np.random.default_rng(1)
    run = record(random_leg(rng), rng, Timing(200), seconds=2.0)
    late = with_delay(run, 0.010)
    assert np.isnan(late["tau2_nm"][:2]).all()
    assert_allclose(late["tau2_nm"][2:], run["tau2_nm"][:-2], atol=1e-9)
    early = with_delay(run, -0.005)
    assert_allclose(early["tau2_nm"][:-1], run["tau2_nm"][1:], atol=1e-9)
    assert_array_equal(late["q2_rad"], run["q2_rad"])


def test_a_stated_delay_is_applied_once_and_explains_the_runs() -> None:
    rng = np.random.default_rng(2)
    leg = random_leg(rng)
    runs = [record(leg, rng, Timing(200, delay_s=0.007), name=name) for name in "ab"]
    rig = parse_rig(RIG + "[timing]\ntorque_delay_s = [0.007, 0.0005]\n")
    prepared = prepare(runs, rig)
    again = prepare(prepared.setup.datasets, rig)
    assert_array_equal(again.setup.datasets[0]["tau2_nm"], prepared.setup.datasets[0]["tau2_nm"])
    found = legid.fit(runs, rig)
    assert found.beta[:5] == pytest.approx(leg.beta()[:5], rel=1e-2)
    assert not any(one.effect == "torque_delay" for one in found.estimate.omitted)


@pytest.mark.parametrize("period_s, hold", [
    (0.005, "zero"), (0.010, "zero"), (0.001, "zero/5"), (0.0025, "zero/2"), (0.0001, "smooth")])
def test_a_stated_control_period_is_the_hold(period_s: float, hold: str) -> None:
    rng = np.random.default_rng(3)
    run = record(random_leg(rng), rng, Timing(200), seconds=2.0)
    rig = parse_rig(RIG + f"[timing]\ncontrol_period_s = {period_s}\n")
    assert prepare([run], rig).setup.options.hold == hold
