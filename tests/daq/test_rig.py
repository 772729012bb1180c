"""rig.toml: what is accepted, and that what is not names file, key and remedy."""

from pathlib import Path

import pytest

from daq.errors import InputError
from daq.rig import joint_count, load_rig, parse_rig

LEG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n'


def test_the_documented_example_is_read() -> None:
    rig = parse_rig(LEG + "gravity_mps2 = 9.81\n[imu]\nlever_arm_m = 0.20\n[motor]\ngear_ratio = 50.0\n[noise]\n"
                    "gyro_radps = 0.005\naccel_mps2 = 0.05\ntorque_nm = 0.02\nencoder_rad = 4e-4\n"
                    "[sampling]\nrate_hz = 100.0\n")
    assert (rig.mechanism.model, rig.mechanism.actuated, rig.imu.lever_arm_m) == ("leg2", (2,), 0.20)
    assert (rig.noise.encoder_rad, rig.sampling.rate_hz, rig.sampling.hold) == (4e-4, 100.0, "linear")


def test_what_is_absent_is_unknown_or_default() -> None:
    rig = parse_rig(LEG)
    assert rig.noise.gyro_radps is None
    assert rig.devices.imu is None
    assert rig.limits.staleness_s == 0.1
    assert rig.calibration.imu_mount[0] == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(("text", "named"), [
    ('[mechanism]\nmodel = "leg3"\nactuated = [2]\n', "mechanism.model"),
    ('[mechanism]\nmodel = "leg2"\n', "actuated"),
    (LEG + "[sampling]\nrate_hz = -1\n", "sampling.rate_hz"),
    (LEG + '[sampling]\nrate_hz = "fast"\n', "sampling.rate_hz"),
    (LEG + '[sampling]\nhold = "cubic"\n', "sampling.hold"),
    (LEG + "[limits]\ntorque = 1\n", "torque"),
    (LEG.replace("[2]", "[3]"), "joint 3"),
    (LEG + "[terms]\nrotor_inertia = [4]\n", "joint 4"),
    ("mechanism = ", "TOML"),
])
def test_a_fault_names_file_and_key(text: str, named: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_rig(text, "bench.toml")
    line = str(caught.value)
    assert line.startswith("bench.toml: ")
    assert named in line
    assert "\n" not in line


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.toml"):
        load_rig(tmp_path / "nowhere.toml")
    (tmp_path / "latin.toml").write_bytes(b"# gr\xfc\xdfe\n")
    with pytest.raises(InputError, match="UTF-8"):
        load_rig(tmp_path / "latin.toml")


def test_joints_of_each_mechanism() -> None:
    counts = {"leg2": 2, "biped3": 3, "joint1": 1}
    for model, n in counts.items():
        assert joint_count(parse_rig(f'[mechanism]\nmodel = "{model}"\nactuated = [1]\n').mechanism) == n
    assert joint_count(parse_rig('[mechanism]\nmodel = "chain"\nactuated = [1]\nlinks = 7\n').mechanism) == 7
