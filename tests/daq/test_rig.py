"""rig.toml: what is accepted, and that what is not names file, key and remedy."""

from pathlib import Path

import pytest

from daq import InputError, joint_count, load_rig, parse_rig

LEG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n'


def test_the_documented_example_is_read() -> None:
    rig = parse_rig(LEG + "gravity_mps2 = 9.81\n[imu]\nlever_arm_m = 0.20\n[motor]\ngear_ratio = 50.0\n[noise]\n"
                    "gyro_radps = 0.005\naccel_mps2 = 0.05\ntorque_nm = 0.02\nencoder_rad = 4e-4\n"
                    "[sampling]\nrate_hz = 100.0\n")
    assert (rig.mechanism.model, rig.mechanism.actuated, rig.imus[0].lever_arm_m) == ("leg2", (2,), 0.20)
    assert (rig.noise.encoder_rad, rig.sampling.rate_hz, rig.sampling.hold) == (4e-4, 100.0, "auto")


def test_what_is_absent_is_unknown_or_default() -> None:
    rig = parse_rig(LEG)
    assert rig.noise.gyro_radps is None and rig.devices.imu is None
    assert (rig.limits.staleness_s, rig.calibration.imu_mount[0]) == (0.1, (1.0, 0.0, 0.0))


MOUNT = "[calibration]\nimu_mount = "
NONSENSE = [
    ("[limits]\nspeed_radps = nan", "limits.speed_radps"),
    ("[limits]\nq2_rad = 90", "limits.q2_rad"), ("[limits]\nstaleness_s = 1e9", "limits.staleness_s"),
    ("[calibration]\nknee_zero_rad = -inf", "knee_zero_rad"), ("[calibration]\nknee_zero_rad = nan", "knee_zero_rad"),
    ("[calibration]\ngyro_bias_radps = [nan, 0, 0]", "gyro_bias_radps"),
    ("[devices.imu]\nrate_hz = -1", "rate_hz"), ("[sampling]\nrate_hz = inf", "sampling.rate_hz"),
    ("[imu]\nlever_arm_m = nan", "lever_arm_m"), ("[noise]\ngyro_radps = inf", "gyro_radps"),
    (MOUNT + "[[0, 0, 0], [0, 0, 0], [0, 0, 0]]", "imu_mount"),
    (MOUNT + "[[2, 0, 0], [0, 2, 0], [0, 0, 2]]", "imu_mount"),
    ("[calibration]\naccel_matrix = [[1, 0, 0], [1, 0, 0], [0, 0, 1]]", "accel_matrix"),
    ("[noise]\nencoder_rad = [0.001, inf]", "encoder_rad"), ("[noise]\nencoder_rad = [0.001]", "1 levels"),
    ("[noise]\nencoder_rad = [0.001, -1]", "encoder_rad"), ("[noise]\npassive_nm = 0", "passive_nm"),
    ("[terms]\nrotor_inertia = [2, 2]", "twice"), ("x = " + "[" * 100_000, "nested"),
    ("x = " + "{a=" * 100_000, "nested"),
]


NOISE = [
    ("accel_mps2 = [0.05]", "noise.accel_mps2 has 1 levels"), ("accel_mps2 = [0.05, 0.0]", "noise.accel_mps2"),
    ("accel_mps2 = [0.1, 0.1, 0.1]", "noise.accel_mps2 has 3 levels"), ("accel_mps2 = [0.1, nan]", "noise.accel_mps2"),
    ("torque_nm = [0.02]", "noise.torque_nm has 1 levels, the mechanism has 2 driven joints"),
    ("torque_nm = [0.02, -0.02]", "noise.torque_nm"), ("accel_correlation = 1.0", "noise.accel_correlation is 1"),
    ("accel_correlation = 2", "noise.accel_correlation"), ("accel_correlation = nan", "noise.accel_correlation"),
    ("torque_correlation = [[1.0]]", "noise.torque_correlation is not 2 by 2"),
    ("torque_correlation = [[1.0, 0.2], [0.3, 1.0]]", "noise.torque_correlation is not symmetric"),
    ("torque_correlation = [[0.9, 0.2], [0.2, 1.0]]", "noise.torque_correlation is not symmetric with 1"),
    ("torque_correlation = [[1.0, 1.0], [1.0, 1.0]]", "noise.torque_correlation is not positive definite"),
    ("torque_correlation = [[1.0, nan], [nan, 1.0]]", "noise.torque_correlation"),
    ("torque_correlation = 0.3", "noise.torque_correlation")]
"""Of an arm with two driven joints."""


@pytest.mark.parametrize("text, named", [
    ('[mechanism]\nmodel = "leg3"\nactuated = [2]\n', "mechanism.model"),
    ('[mechanism]\nmodel = "leg2"\n', "actuated"),
    (LEG + "[sampling]\nrate_hz = -1\n", "sampling.rate_hz"),
    (LEG + '[sampling]\nrate_hz = "fast"\n', "sampling.rate_hz"),
    (LEG + '[sampling]\nhold = "cubic"\n', "sampling.hold"),
    (LEG + "[limits]\ntorque = 1\n", "torque"),
    (LEG.replace("[2]", "[3]"), "joint 3"),
    (LEG + "[limits]\ntorque_nm = inf\n", "`limits.torque_nm`"),
    (LEG + "[limits]\nq2_rad = nan\n", "limits.q2_rad"),
    (LEG + "[limits]\nunchecked = ['q2_rad']\n", "limits.unchecked"),
    (LEG + "[calibration]\ntorque_constant_nm_per_a = 1e9\n", "calibration.torque_constant_nm_per_a"),
    (LEG + "[calibration]\nimu_mount = [[1, 0, 0], [0, 1, 0], [0, 0, 0]]\n", "imu_mount is no rotation: row 3 has"),
    (LEG + "[calibration]\nimu_mount = [[1, 0, 0], [1, 0, 0], [0, 0, 1]]\n", "rows 1 and 2 are not at right angles"),
    (LEG + "[devices.controller]\nbaud = -1\n", "devices.controller.baud"),
    (LEG + "[devices.imu]\naddress = 99999\n", "devices.imu.address"),
    (LEG + "[terms]\nrotor_inertia = [4]\n", "joint 4"),
    ("mechanism = ", "TOML"),
    *((LEG + text, named) for text, named in NONSENSE),
    *((f"{LEG.replace('[2]', '[2, 1]')}[noise]\n{text}", named) for text, named in NOISE),
])
def test_a_fault_names_file_and_key(text: str, named: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_rig(text, "bench.toml")
    line = str(caught.value)
    assert line.startswith("bench.toml: ")
    assert named in line and "\n" not in line and len(line) < 312


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.toml"):
        load_rig(tmp_path / "nowhere.toml")
    (tmp_path / "latin.toml").write_bytes(b"# gr\xfc\xdfe\n")
    with pytest.raises(InputError, match="UTF-8"):
        load_rig(tmp_path / "latin.toml")


def test_joints_of_each_mechanism() -> None:
    for model, n in (('"leg2"', 2), ('"biped3"', 3), ('"joint1"', 1), ('"chain"\nlinks = 7', 7)):
        assert joint_count(parse_rig(f"[mechanism]\nmodel = {model}\nactuated = [1]\n").mechanism) == n


def test_a_leg_s_hip_has_no_torque_level() -> None:
    with pytest.raises(InputError, match=r"noise\.torque_nm has 2 levels, the mechanism has 1 driven joint"):
        parse_rig(LEG + "[noise]\ntorque_nm = [0.01, 0.02]")
    assert parse_rig(LEG + "[noise]\ntorque_nm = [0.02]").noise.torque_nm == (0.02,)
