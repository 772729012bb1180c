"""`Loop` against the law written out by hand, and `[servo]` tables as loops."""

import numpy as np
import pytest

from daq import InputError, Loop, parse_rig

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[servo]\n'


def test_a_drive_that_makes_torque() -> None:
    loop = Loop(gain=6.0, damping=0.2, integral=1.5, limit=2.0)
    wanted = loop.wanted(*np.array([[0.1, -0.9, 0.0], [0.5, 0.0, -1.0], [0.2, 0.0, 0.4]]))  # error, its rate, its sum
    assert wanted == pytest.approx([0.6 + 0.1 + 0.3, -2.0, -0.2 + 0.6])
    assert loop.acting(wanted, np.full(3, 7.0), 1.0) == pytest.approx(wanted)


def test_a_motor_on_voltage_brakes_by_its_back_emf_and_is_limited_by_its_current() -> None:
    rig = parse_rig(RIG + "gain = 2.0\nresistance_ohm = 4.0\ntorque_constant_nm_per_a = 0.4\nsupply_v = 8.0\n"
                    "current_a = 1.5\n")
    loop = rig.servo.loop(0, False)
    assert loop.limit == 1.0  # duty
    duty, rate = loop.wanted(np.array([0.2, 2.0]), np.zeros(2)), np.array([3.0, -6.0])
    assert duty == pytest.approx([0.4, 1.0])
    current = (8.0 * duty - 0.4 * rate) / 4.0
    assert loop.acting(duty, rate, np.full(2, loop.supply)) == pytest.approx(0.4 * np.minimum(current, 1.5))


def test_arrays_of_several_segments() -> None:
    along = Loop.along([[None, Loop(3.0, limit=1.0)], [None, Loop(5.0)]], [2, 3])
    gain, limit = np.asarray(along.gain), np.asarray(along.at((..., slice(1, 3))).limit)
    assert np.isnan(gain[0]).all() and gain[1] == pytest.approx([3, 3, 5, 5, 5])
    assert limit[1] == pytest.approx([1.0, np.inf])


def test_a_delay_and_a_gain_with_tolerances_are_in_the_budget() -> None:
    table = RIG + "gain = 8.0\ndelay_s = 0.01\n[servo.tolerance]\ngain = 0.4\ndelay_s = 0.002\n"
    assert parse_rig(table).tolerances == {"torque_gain": (0.05,), "command_delay": (0.002,)}
    filtered = parse_rig(table + "command_filter_s = 0.0015\nvelocity_filter_s = 0.003\n").tolerances
    assert filtered["command_delay"] == pytest.approx((0.0025,)) and filtered["velocity_filter"] == (0.003,)
    assert parse_rig(table + "[tolerance]\ntorque_gain = 0.01\n").tolerances["torque_gain"] == (0.01,)
    assert parse_rig(table + "[tolerance]\nnone = true\n").tolerances == {"none": ()}


@pytest.mark.parametrize("servo, what", [
    ("integral = 0.1\n", "says nothing without servo.gain"),
    ("gain = 1.0\nresistance_ohm = 3.0\n", "one of resistance_ohm"),
    ("gain = 1.0\nrate_hz = 0.0\n", "rate_hz"),
    ("gain = 1.0\nvelocity_filter_s = -0.1\n", "velocity_filter_s"),
    ("gain = 1.0\ndelay_s = -1.1\n", "delay_s")])
def test_a_table_that_says_too_little_is_refused(servo: str, what: str) -> None:
    with pytest.raises(InputError, match=what):
        parse_rig(RIG + servo)


def test_a_resistance_of_a_joint_that_volts_drive_is_refused() -> None:
    with pytest.raises(InputError, match="makes a torque of the duty, and mechanism"):
        parse_rig('[mechanism]\nmodel = "joint1"\nactuated = [1]\ninput = "voltage"\n[servo]\ngain = 1.0\n'
                  "resistance_ohm = 4.0\ntorque_constant_nm_per_a = 0.4\nsupply_v = 8.0\n")
