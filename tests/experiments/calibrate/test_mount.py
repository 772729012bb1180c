"""`legid calibrate mount`: MuJoCo swings the leg, its sensors are turned, offset and disturbed."""

from pathlib import Path
from typing import Any

import msgspec
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from daq import Calibration, load_rig
from estimator import FitError
from estimator.calibration import Readings, fit_mount
from tests.support.motor_off_runs import IMU_HZ, RIG, TELEMETRY_HZ, write_off
from tests.support.mujoco_leg import GRAVITY, Leg
from tests.support.processes import REAL_CLOCK
from tests.support.shell import Shell

pytestmark = REAL_CLOCK

SUBSTEPS = 5
SECONDS = 10.0
LEG = Leg(coulomb=(0.005, 0.05))
GYRO, ACCEL = 0.005, 0.05


@pytest.fixture(scope="module")
def motion() -> np.ndarray:
    """(n, 4) q1 and the IMU's q1d, a_x, a_y at `IMU_HZ`, of a free leg that is let go."""
    model = LEG.model(1.0 / (IMU_HZ * SUBSTEPS))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.6, -0.3
    out = np.empty((int(SECONDS * IMU_HZ), 4))
    for k in range(len(out)):
        for i in range(SUBSTEPS):
            data.qfrc_applied[:] = -np.array(LEG.coulomb) * np.tanh(data.qvel / 3e-3)
            if i == 0:
                mujoco.mj_forward(model, data)
                s = data.sensordata
                out[k] = data.qpos[0], -s[4], s[0], -s[2]  # as in mujoco_leg
            mujoco.mj_step(model, data)
    return out


def mount_of(seed: int) -> np.ndarray:
    """A turned mount, left-handed for odd seeds."""
    rows = Rotation.random(random_state=seed).as_matrix()
    return rows * np.array([[-1.0 if seed % 2 else 1.0], [1.0], [1.0]])


def chip(mount: np.ndarray, link: np.ndarray, gyro_bias: np.ndarray, accel_bias: np.ndarray,
         rng: np.random.Generator) -> np.ndarray:
    """(n, 6) readings of a chip whose mount has these rows, from `link` (n, 3): rate, a_x, a_y."""
    gyro = link[:, :1] * mount[2] + gyro_bias + GYRO * rng.standard_normal((len(link), 3))
    accel = link[:, 1:] @ mount[:2] + accel_bias + ACCEL * rng.standard_normal((len(link), 3))
    return np.hstack([gyro, accel])


def mount_found(raw: np.ndarray, rest: np.ndarray, half: np.ndarray, axis: np.ndarray) -> Any:
    times = np.arange(len(raw)) / IMU_HZ
    return fit_mount([Readings(times, raw[:, :3], raw[:, 3:])], [(rest, half)], axis, GRAVITY)


def test_mount_and_lever_are_found_without_bias_and_within_their_intervals(motion: np.ndarray) -> None:
    errors, halves = [], []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        mount, gyro_bias, accel_bias = mount_of(seed), rng.normal(0, 0.05, 3), rng.normal(0, 0.2, 3)
        raw = chip(mount, motion[:, 1:], gyro_bias, accel_bias, rng)
        still = np.full(3, ACCEL / np.sqrt(1500))  # six seconds of rest
        rest = np.array([0.0, -GRAVITY]) @ mount[:2] + accel_bias + still * rng.standard_normal(3)
        found = mount_found(raw, rest, 2 * still, mount[2] + 0.2)
        turn = found.mount @ mount.T
        assert np.linalg.det(turn) > 0.99  # the handedness is told from data
        np.testing.assert_allclose(found.mount @ found.mount.T, np.eye(3), atol=1e-12)
        errors.append([found.lever_m - LEG.lever, found.side_offset_m, *Rotation.from_matrix(turn).as_rotvec(),
                       *(found.accel_bias_mps2 - accel_bias), *(found.gyro_bias_radps - gyro_bias)])
        halves.append([found.lever_half, found.side_offset_half, *found.angle_half, *found.accel_bias_half,
                       *found.gyro_bias_half])
        assert found.noise == pytest.approx((GYRO, ACCEL), rel=0.1)  # dry friction leaves corners
    off, allowed = np.array(errors), np.array(halves)
    assert np.mean(np.abs(off) < allowed) > 0.85
    assert allowed[:, 0].max() < 1.5e-3
    # no noise bias: the mean of five is off by no more than noise makes it (half / 2 is about one sigma)
    assert np.abs(off[:, 0].mean()) < 3.0 * 0.5 * allowed[:, 0].mean() / np.sqrt(5)
    assert np.abs(off.mean(axis=0) / allowed.mean(axis=0)).max() < 1.0


def test_noise_does_not_shorten_the_lever(motion: np.ndarray) -> None:
    """Four times the noise: a regression on the differentiated gyro would lose most of l (its regressor's noise alone
    is GYRO * rate / sqrt(2), as large as the acceleration)."""
    rng = np.random.default_rng(0)
    mount = mount_of(0)
    link = motion[:, 1:]
    noise = 4.0 * np.repeat([GYRO, ACCEL], 3) * rng.standard_normal((len(link), 6))
    raw = np.hstack([link[:, :1] * mount[2], link[:, 1:] @ mount[:2]]) + noise
    rest = np.array([0.0, -GRAVITY]) @ mount[:2]
    found = mount_found(raw, rest, np.full(3, 1e-3), mount[2])
    rate = raw[:, :3] @ mount[2]
    angle_acceleration = np.gradient(rate, 1 / IMU_HZ)
    table = np.column_stack([angle_acceleration, np.sin(motion[:, 0]), np.ones(len(rate))])
    naive = np.linalg.lstsq(table, raw[:, 3:] @ mount[0], rcond=None)[0][0]
    assert abs(naive - LEG.lever) > 0.05
    assert abs(found.lever_m - LEG.lever) < found.lever_half < 0.005


def test_swings_too_small_are_refused(motion: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    small = chip(mount_of(0), np.column_stack([motion[:, 1] * 0.1, 0 * motion[:, 2], np.full(len(motion), -GRAVITY)]),
                 np.zeros(3), np.zeros(3), rng)
    with pytest.raises(FitError, match="push it harder"):
        mount_found(small, -GRAVITY * mount_of(0)[1], np.full(3, 1e-3), mount_of(0)[2])


@pytest.mark.parametrize("hall_sign", [0, -1])
def test_the_command_writes_mount_and_lever(motion: np.ndarray, here: Path, hall_sign: int, shell: Shell) -> None:
    rng = np.random.default_rng(4)
    # turned by a quarter and a little, as somebody screwed it on; rig.toml says nothing of it
    true = Rotation.from_euler("zyx", [90.0, 2.0, -3.0], degrees=True).as_matrix()
    bias = np.array([0.02, -0.01, 0.005])
    rest = chip(true, np.tile([0.0, 0.0, -GRAVITY], (1500, 1)), bias, np.zeros(3), rng)
    swung = chip(true, motion[:, 1:], bias, np.zeros(3), rng)
    hall = None
    if hall_sign:  # the pivot's sensor grows the other way: that is the way q1 is meant to grow
        at = np.arange(int(SECONDS * TELEMETRY_HZ)) / TELEMETRY_HZ
        hall = hall_sign * np.interp(at, np.arange(len(motion)) / IMU_HZ, motion[:, 0])
    paths = [write_off(here / "rest.mcap", 6.3, readings=rest),
             write_off(here / "swing.mcap", SECONDS, readings=swung, hall_rad=hall)]
    rig = here / "rig.toml"
    rig.write_text(RIG)
    shell("calibrate mount", *paths, "--rig rig.toml --dry-run")
    assert rig.read_text() == RIG
    shell("calibrate mount", *paths, "--rig rig.toml")
    out = shell.out
    found = load_rig(rig)
    wanted = true * (np.array([[-1.0], [1.0], [-1.0]]) if hall_sign else 1.0)
    turn = Rotation.from_matrix(np.array(found.calibration.imu_mount) @ wanted.T)
    assert turn.magnitude() < 0.006  # the angle about z has the accelerometer's unknown bias in it
    assert found.imu.lever_arm_m == pytest.approx(LEG.lever, abs=1e-3)
    assert set(found.tolerances) == {"imu_lever_arm"}  # of the angle about z friction's share is not known
    assert found.tolerances["imu_lever_arm"][0] < 1e-3
    assert ("Hall sensor says" in out) == bool(hall_sign)
    assert "# by the drawing" in rig.read_text()
    assert msgspec.structs.replace(found.calibration, imu_mount=Calibration().imu_mount,
                                   torque_constant_nm_per_a=1.0) == Calibration()

    assert "the leg swings in no record" in shell.fails("calibrate mount", paths[0], "--rig rig.toml", status=1)
    assert "leg hanging still" in shell.fails("calibrate mount", paths[1], "--rig rig.toml", status=1)
