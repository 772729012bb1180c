"""`legid calibrate imu` on a chip whose errors are known, from files and from the chip, into rig.toml."""

from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from numpy.testing import assert_allclose

from daq import Calibration, InputError, WorkError, imu_columns, load_rig, parse_rig, set_values
from daq.calibration import StillRecord, calibrate_accel, calibrate_gyro
from daq.calibration.imu import AXES
from daq.runs import RunWriter
from drivers import ImuConfig, Lsm9ds1, SelfTest
from drivers.mock import ImuSettings, MockRig, VirtualClock
from drivers.mock.lsm9ds1 import MockLsm9ds1
from experiments.calibrate import store
from experiments.calibrate.outcome import Outcome
from tests.support.motor_off_runs import IMU_HZ, add_imu
from tests.support.processes import REAL_CLOCK
from tests.support.shell import Shell
from tests.support.still_plant import StillPlant

pytestmark = REAL_CLOCK

G = 9.81
BIAS = np.array([0.25, -0.4, 0.1])
GYRO_BIAS = np.array([0.01, -0.02, 0.03])
DISTORTION = np.array([[1.02, 0.004, -0.003], [0.002, 0.97, 0.005], [-0.004, 0.003, 1.01]])
RIG = """[mechanism]
model = "leg2"
actuated = [2]
gravity_mps2 = 9.81

[calibration]  # measured on the bench
knee_zero_rad = 0.1
accel_bias_mps2 = [1.0,
    2.0,  # an old one
    3.0]

[limits]
torque_nm = 1.5  # the gearbox
"""


def up(axis: str) -> np.ndarray:
    return G * np.eye(3)["xyz".index(axis[1])] * (1 if axis[0] == "+" else -1)


def still(axis: str, seed: int = 0, seconds: float = 20.0, rate: float = 240.0) -> StillRecord:
    rng = np.random.default_rng(seed)
    n = int(seconds * rate)
    return StillRecord(axis, rate, GYRO_BIAS + 0.005 * rng.standard_normal((n, 3)),
                       DISTORTION @ up(axis) + BIAS + 0.05 * rng.standard_normal((n, 3)))


def six_records() -> list[StillRecord]:
    return [still(axis, k) for k, axis in enumerate(AXES)]


def test_six_positions_give_bias_and_matrix_in_any_order() -> None:
    found = calibrate_accel(six_records()[::-1], G)
    # each position's mean has 0.05 / sqrt(4800) = 7e-4 of noise
    assert_allclose(found.bias_mps2, BIAS, atol=2e-3)
    assert_allclose(found.matrix @ DISTORTION, np.eye(3), atol=3e-4)
    assert found.residual_mps2 < 3e-3


def test_calibrated_readings_are_gravity() -> None:
    found = calibrate_accel(six_records(), G)
    rig = parse_rig(set_values(RIG, {"calibration": {"accel_bias_mps2": found.bias_mps2.tolist(),
                                          "accel_matrix": found.matrix.tolist()}}))
    tilted = np.array([3.0, -2.0, 9.0])
    scale = (1e-3, 1e-4)
    counts = np.rint(np.hstack([np.zeros(3), (DISTORTION @ tilted + BIAS) / scale[1]])).astype(int)[None, :]
    columns = imu_columns(counts, scale, rig.calibration)
    assert [columns[f"accel_{axis}_mps2"][0] for axis in "xy"] == pytest.approx([3.0, -2.0], abs=5e-3)


def test_what_is_missing_doubled_moved_or_tilted_is_said() -> None:
    with pytest.raises(WorkError, match=r"six positions are needed, -z up missing"):
        calibrate_accel(six_records()[:5], G)
    with pytest.raises(WorkError, match=r"position \+x is there twice"):
        calibrate_accel([still("+x"), still("+x", 9)], G)
    moved = still("+z")
    moved.gyro_radps[2000:2400, 1] += 0.3
    with pytest.raises(WorkError, match=r"moved about 8\.\d s into the record"):
        calibrate_gyro(moved)
    askew = StillRecord("askew", 240.0, moved.gyro_radps[:1500],
                        np.full((1500, 3), G / np.sqrt(3)))
    with pytest.raises(WorkError, match="no axis points up or down"):
        calibrate_accel([askew], G)
    with pytest.raises(WorkError, match="too short"):
        calibrate_gyro(still("+z", seconds=2.0))


def test_rig_text_keeps_everything_else() -> None:
    new = set_values(RIG, {"calibration": {"accel_bias_mps2": [0.1, 0.2, 0.3], "gyro_bias_radps": [0.0, 0.0, 0.01]}})
    assert "# measured on the bench" in new and "# the gearbox" in new and "an old one" not in new
    before, after = parse_rig(RIG), parse_rig(new)
    assert after.calibration.accel_bias_mps2 == (0.1, 0.2, 0.3)
    assert after.calibration.knee_zero_rad == 0.1
    assert msgspec.structs.replace(after, calibration=before.calibration) == before
    bare = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n'
    filled = set_values(bare, {"calibration": {"gyro_bias_radps": [1.0, 2.0, 3.0]}})
    assert parse_rig(filled).calibration.gyro_bias_radps[2] == 3.0


def test_a_tolerance_of_one_joint_is_set_next_to_others() -> None:
    stated = RIG + "\n[tolerance]\nencoder_offset.1 = 0.01  # by eye\n# imu_lever_arm = 0.002\n"
    new = set_values(stated, {"tolerance": {"encoder_offset.2": 0.004, "imu_lever_arm": 0.001}})
    assert parse_rig(new).tolerances == {"encoder_offset@1": (0.01,), "encoder_offset@2": (0.004,),
                                         "imu_lever_arm": (0.001,)}
    assert "# by eye" in new
    again = set_values(new, {"tolerance": {"encoder_offset.2": 0.003}})
    assert parse_rig(again).tolerances["encoder_offset@2"] == (0.003,)


@pytest.mark.parametrize("stated, written", [
    ("", {"encoder_offset@2": (0.004,), "gyro_scale": (0.002,)}),
    ("[tolerance]\nencoder_offset = 0.1\ngyro_scale = 0.5", {"encoder_offset": (0.1,), "gyro_scale": (0.002,)}),
    ("[tolerance]\nnone = true", {"none": ()})])
def test_what_a_rig_says_of_all_joints_or_of_none_stays(tmp_path: Path, stated: str, written: dict) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(f"{RIG}\n{stated}\n")
    found = Outcome("", {"calibration": {"knee_zero_rad": 0.2}},
                    tolerances={"encoder_offset.2": 0.004, "gyro_scale": 0.002, "imu_lever_arm": 0.0})
    store(found, str(path), False)
    assert load_rig(path).tolerances == written
    assert load_rig(path).calibration.knee_zero_rad == 0.2


def test_rig_text_written_otherwise_is_refused_not_spoilt() -> None:
    inline = 'calibration = {knee_zero_rad = 0.1}\n[mechanism]\nmodel = "leg2"\nactuated = [2]\n'
    with pytest.raises(InputError, match="by hand"):
        set_values(inline, {"calibration": {"gyro_bias_radps": [1.0, 2.0, 3.0]}})


def write_still(path: Path, axis: str, seed: int) -> Path:
    """A run file of an IMU lying still for 20 s."""
    writer, record = RunWriter(path, {"rig.toml": RIG}), still(axis, seed, 20.0, IMU_HZ)
    add_imu(writer, np.hstack([record.gyro_radps, record.accel_mps2]))
    writer.close()
    return path


def test_the_command_on_six_files(here: Path, shell: Shell) -> None:
    rig = here / "rig.toml"
    rig.write_text(RIG)
    paths = [write_still(here / f"{k}.mcap", axis, k) for k, axis in enumerate(AXES)]
    shell("calibrate imu", *paths, "--rig rig.toml --dry-run")
    assert rig.read_text() == RIG
    shell("calibrate imu", *paths, "--rig rig.toml")
    out = shell.out
    assert "gyro x" in out and "density" in out
    found = load_rig(rig).calibration
    assert_allclose(found.gyro_bias_radps, GYRO_BIAS, atol=3e-4)
    assert_allclose(found.accel_bias_mps2, BIAS, atol=5e-3)
    assert_allclose(np.array(found.accel_matrix) @ DISTORTION, np.eye(3), atol=1e-3)
    left = load_rig(rig).tolerances  # of the bias alone, both axes alike, far below the default of 0.1
    assert set(left) == {"accelerometer_bias"}
    assert left["accelerometer_bias"][0] == left["accelerometer_bias"][1] < 0.01
    assert "one still record, or six" in shell.fails("calibrate imu", *paths[:2], "--rig rig.toml")


class Bench:
    """An emulated chip that lies still, with noise, on virtual time."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.chip = MockLsm9ds1(self.clock, advance=self.advance)
        self.next_ns, self.rng = 0.0, np.random.default_rng(5)

    def advance(self, t_ns: int) -> None:
        self.next_ns = self.next_ns or t_ns
        while self.chip.rate_hz and self.next_ns <= t_ns:
            gyro, accel = ImuConfig().scale
            values = np.hstack([GYRO_BIAS / gyro, np.array([0.0, 0.0, G]) / accel])
            self.chip.push(np.rint(values + 5.0 * self.rng.standard_normal(6)).astype(int).tolist())
            self.next_ns += 1e9 / self.chip.rate_hz


def test_the_command_on_the_chip_itself(here: Path, shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    bench, rig = Bench(), here / "rig.toml"
    rig.write_text(RIG + "[devices.imu]\n")
    monkeypatch.setattr("experiments.rig.devices.open_bus", lambda path: bench.chip)
    now_ns, sleep = bench.clock.now_ns, bench.clock.sleep  # the clocks that the command takes by default
    monkeypatch.setattr(Lsm9ds1.__init__, "__defaults__", (0x6B, None, now_ns, 400.0, sleep))
    monkeypatch.setattr(SelfTest.__init__, "__defaults__", (sleep, now_ns))
    monkeypatch.setattr("experiments.calibrate.imu.time", SimpleNamespace(monotonic_ns=now_ns, sleep=sleep))
    shell("calibrate imu --rig rig.toml --seconds 20 --self-test")
    out = shell.out
    assert "accelerometer passed" in out and "gyroscope passed" in out
    assert_allclose(load_rig(rig).calibration.gyro_bias_radps, GYRO_BIAS, atol=3e-4)
    bench.chip.self_test_dps = 0.0
    assert "self-test failed" in shell.fails("calibrate imu --rig rig.toml --seconds 20 --self-test", status=1)
    rig.write_text(RIG)
    shell("calibrate imu --rig rig.toml", status=2)


def test_an_emulated_chip_errs_by_what_the_calibration_takes_out() -> None:
    matrix = ((1.1, 0.02, 0.0), (0.0, 0.9, 0.0), (0.0, 0.01, 1.0))
    clock = VirtualClock()
    rig = MockRig(StillPlant(), clock, ImuSettings(accel_noise_mps2=0.0, gyro_noise_radps=0.0, accel_matrix=matrix))
    imu = Lsm9ds1(rig.imu, now_ns=clock.now_ns, sleep=clock.sleep)
    imu.open()
    clock.sleep(0.05)
    columns = imu_columns(imu.drain().raw, imu.scale, Calibration(accel_matrix=matrix))
    assert_allclose(columns["accel_y_mps2"], -9.81, atol=3e-3)
    assert_allclose(columns["accel_x_mps2"], 0.0, atol=3e-3)
