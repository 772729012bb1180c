"""`largest_unknown`: the tolerance that would move the parameters most, by the rig file."""


import pytest

from daq import parse_rig
from experiments.doctor.unknown import largest_unknown

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = 0.2\n'


@pytest.mark.parametrize("text, words", [
    ("", "the torque constant, 5 % (1 sigma, by default)"),
    ("[tolerance]\ntorque_gain = 0.002\n", "accelerometer's zero, 1 %"),
    ("[tolerance]\ntorque_gain = 0.002\nimu_lever_arm = 0.01\n", "distance from the pivot, 5 % (1 sigma, as stated)"),
    ("[tolerance]\nnone = true\n", "noise and scatter alone"),
    ("[tolerance]\nnone = true\ngyro_scale = 0.02\n", "gyro's scale, 2 % (1 sigma, as stated): legid calibrate")])
def test_the_largest_tolerance_is_named_with_what_shows_it(text: str, words: str) -> None:
    found = largest_unknown(parse_rig(RIG + text))
    assert found.status == "ok" and words in found.words


def test_a_calibrated_torque_constant_is_no_longer_the_largest() -> None:
    rig = parse_rig(RIG + "[calibration]\ntorque_constant_nm_per_a = 0.05\ntorque_constant_half_nm_per_a = 0.0001\n")
    assert "torque constant" not in largest_unknown(rig).words
