"""`legid calibrate imu-encoder`: motions in closed form, read by an IMU with known errors; a public record."""

from pathlib import Path

import numpy as np
import pytest

from daq import load_rig, parse_rig
from estimator import FitError
from estimator.calibration import EncoderFit, Segment, fit_imu
from experiments.calibrate import compare, read_moving
from experiments.emulation import record_emulated
from experiments.excite import random_multisine
from studies.casebook import RIGS
from tests.support.motor_off_runs import IMU_HZ, RIG, TELEMETRY_HZ, write_off
from tests.support.paths import DEMO_RIG, REAL
from tests.support.shell import Shell

G = 9.81
RATE = 100.0
RECORD = REAL / "song_imu/pitch_medium_120s.csv.gz"
TRUTH = {"gyro_bias": 0.02, "gyro_scale": -0.015, "gyro_late": 0.0042, "accel_bias_x": 0.15, "accel_bias_y": -0.08,
         "accel_scale_x": 0.02, "accel_scale_y": -0.01, "accel_skew": 0.006, "accel_turn": 0.012, "lever_arm": 0.21,
         "side_offset": 0.004, "accel_late": 0.0028}
NOISE = np.array([0.01, 0.1, 0.1])


class Motion:
    """A sum of sines, with its derivatives."""

    def __init__(self, hz: tuple[float, ...], amplitude: tuple[float, ...]) -> None:
        self.w, self.a = 2 * np.pi * np.array(hz), np.array(amplitude)

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        angle = np.outer(t, self.w) + np.arange(self.w.size)
        return (np.sin(angle) @ self.a, np.cos(angle) @ (self.a * self.w), -np.sin(angle) @ (self.a * self.w**2))


WIDE = Motion((0.21, 0.57, 1.3, 2.2), (0.5, 0.4, 0.2, 0.1))


def readings(motion: Motion, t: np.ndarray, late: np.ndarray | float = 0.0) -> np.ndarray:
    """(n, 3) of an IMU with the errors of `TRUTH`; `late` comes on top."""
    e = TRUTH
    qd = motion.at(t - late - e["gyro_late"])[1]
    q, rate, acceleration = motion.at(t - late - e["accel_late"])
    x = e["lever_arm"] * acceleration - e["side_offset"] * rate**2 + G * np.sin(q)
    y = -e["lever_arm"] * rate**2 - e["side_offset"] * acceleration - G * np.cos(q)
    c, s = np.cos(e["accel_turn"]), np.sin(e["accel_turn"])
    x, y = c * x - s * y, s * x + c * y
    return np.column_stack([(1 + e["gyro_scale"]) * qd + e["gyro_bias"],
                            (1 + e["accel_scale_x"]) * x + e["accel_skew"] * y + e["accel_bias_x"],
                            e["accel_skew"] * x + (1 + e["accel_scale_y"]) * y + e["accel_bias_y"]])


def coloured(rng: np.random.Generator, n: int) -> np.ndarray:
    """(n, 3) white noise, and as much again that lives for a tenth of a second."""
    white, slow = rng.standard_normal((2, n + 9, 3))
    return NOISE * (white[9:] + sum(slow[k: n + k] for k in range(10)) / np.sqrt(10))


def encoder(motion: Motion, t: np.ndarray, step: float = 1.5e-3) -> np.ndarray:
    return np.asarray(np.rint(motion.at(t)[0] / step) * step)


def fitted(motion: Motion, seconds: float, seed: int = 0, late: np.ndarray | float = 0.0, lever: float = 0.2,
           ) -> EncoderFit:
    t = np.arange(round(seconds * RATE)) / RATE
    read = readings(motion, t, late) + coloured(np.random.default_rng(seed), t.size)
    return fit_imu([Segment(encoder(motion, t), read)], RATE, 10.0, lever, G, 0.005)


def check(found: EncoderFit, **expected: tuple[float, float]) -> None:
    """Each value is the first number within the second."""
    for name, (value, close) in expected.items():
        assert found[name].value == pytest.approx(value, abs=close), name


def test_intervals_cover_the_truth_under_coloured_noise() -> None:
    covered = dict.fromkeys(TRUTH, 0)
    runs, determined = 40, 0
    for seed in range(runs):
        found = fitted(WIDE, 60.0, seed)
        for name, value in TRUTH.items():
            covered[name] += abs(found[name].value - value) < found[name].half
            determined += found[name].determined
        assert not found.lag_wanders and not found.held
    assert determined >= 0.95 * runs * len(TRUTH)
    assert min(covered.values()) >= 0.8 * runs and sum(covered.values()) >= 0.91 * runs * len(TRUTH)


def test_the_rest_shows_what_the_correction_is_worth() -> None:
    found = fitted(WIDE, 60.0)
    assert (found.after[:, 0] < [0.2 * found.before[0, 0], 0.5 * found.before[1, 0], found.before[2, 0],
                                 0.5 * found.before[3, 0]]).all()
    # of the noise there are a fifth of the white part's power and most of the slow one's in the band
    left = np.array([*NOISE, NOISE[1] / G])
    assert (np.abs(found.after[:, 0] / left - 1.1) < 0.2).all()
    assert (found.after[:, 1] < 0.2 * found.after[:, 0]).all()


def test_a_lag_that_wanders_is_said_to_and_does_not_spoil_the_rest() -> None:
    t = np.arange(6000) / RATE
    drift = np.where(t < 25, 0.0, 0.012) + 1e-4 * t
    found = fitted(WIDE, 60.0, late=drift)
    assert found.lag_wanders
    assert not found["gyro_late"].determined and not found["accel_late"].determined
    middle = found.lags_s[1:-1] - TRUTH["gyro_late"]
    at = (np.arange(1, found.lags_s.size - 1) + 0.5) * t[-1] / found.lags_s.size
    clear = np.abs(at - 25) > 2
    np.testing.assert_allclose(middle[clear], np.interp(at, t, drift)[clear], atol=2e-3)
    for name in ("gyro_scale", "gyro_bias", "lever_arm", "accel_scale_x"):
        assert found[name].value == pytest.approx(TRUTH[name], abs=2 * found[name].half)
    assert found.after[0, 0] < 0.5 * found.before[0, 0]


def test_a_motion_that_does_not_tell_the_lever_leaves_it_where_it_was() -> None:
    slow = fitted(Motion((0.05,), (1.2,)), 120.0, lever=TRUTH["lever_arm"])
    assert "lever_arm" in slow.held and slow["lever_arm"].value == pytest.approx(TRUTH["lever_arm"])
    for name in ("accel_scale_x", "accel_scale_y", "accel_turn", "accel_bias_x"):
        assert slow[name].value == pytest.approx(TRUTH[name], abs=max(2 * slow[name].half, 2e-3))
    t = np.arange(3000) / RATE
    stranger = readings(Motion((0.3, 1.1), (0.6, 0.3)), t)
    with pytest.raises(FitError, match=r"do not show one motion|belong together"):
        fit_imu([Segment(encoder(WIDE, t), stranger)], RATE, 10.0, 0.2, G)
    with pytest.raises(FitError, match=r"less than 0\.1 rad"):
        fitted(Motion((1.0,), (0.02,)), 30.0)
    with pytest.raises(FitError, match="too few"):
        fitted(WIDE, 8.0)


def test_the_command_writes_what_raw_readings_need(here: Path, shell: Shell) -> None:
    rng = np.random.default_rng(1)
    mount = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    t = np.arange(int(40 * IMU_HZ)) / IMU_HZ
    link = readings(WIDE, t) + 0.3 * NOISE * rng.standard_normal((t.size, 3))
    raw = np.column_stack([link[:, :1] * mount[2], link[:, 1:] @ mount[:2]])
    hall = encoder(WIDE, np.arange(40 * int(TELEMETRY_HZ)) / TELEMETRY_HZ, 4e-4)
    path = write_off(here / "swing.mcap", 40.0, readings=raw, hall_rad=hall)
    rig = here / "rig.toml"
    rig.write_text(RIG.replace("imu_mount = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]", f"imu_mount = {mount.tolist()}"))
    kept = rig.read_text()
    shell("calibrate imu-encoder swing.mcap --rig rig.toml --dry-run")
    assert rig.read_text() == kept
    shell("calibrate imu-encoder swing.mcap --rig rig.toml")
    out = shell.out
    assert "gyro_scale" in out and "# the gearbox" in rig.read_text()
    found = load_rig(rig)
    assert found.imu.lever_arm_m == pytest.approx(TRUTH["lever_arm"], abs=2e-3)
    assert found.calibration.gyro_bias_radps == pytest.approx([0.0, 0.0, TRUTH["gyro_bias"]], abs=3e-3)
    assert found.tolerances["gyro_scale"][0] == pytest.approx(abs(TRUTH["gyro_scale"]), abs=3e-3)  # it stays in
    assert found.tolerances["imu_lever_arm"][0] < 2e-3 and found.tolerances["accelerometer_bias"][0] < 0.05
    # read with the new file, nothing is left but what it has no key for
    again = compare([read_moving(path, found)], found)
    for name in ("gyro_bias", "accel_bias_x", "accel_bias_y", "accel_scale_x", "accel_scale_y", "accel_skew"):
        assert abs(again[name].value) < max(again[name].half, 1e-3)
    check(again, **{name: (TRUTH[name], 3e-3) for name in ("accel_turn", "gyro_scale")})

    write_off(here / "bare.mcap", 3.0, readings=raw[:700])
    assert "has no column q1_rad" in shell.fails("calibrate imu-encoder bare.mcap --rig rig.toml")


def test_a_driven_emulated_leg_shows_lever_and_bias(tmp_path: Path) -> None:
    """Through the emulated chips, drivers, recorder and clocks, which know nothing of the formulas used here."""
    text = DEMO_RIG.read_text()
    record_emulated(tmp_path / "run.mcap", parse_rig(text), text, random_multisine(3, 13.0, 0.7), seed=1)
    path = tmp_path / "rig.toml"
    path.write_text(text.replace("lever_arm_m = 0.20", "lever_arm_m = 0.15").replace("0.0, 0.0, 0.012]",
                                                                                      "0.0, 0.0, 0.0]"))
    rig = load_rig(path)
    assert rig.imus[0].lever_arm_m == 0.15 and not any(rig.calibration.gyro_bias_radps)
    found = compare([read_moving(tmp_path / "run.mcap", rig)], rig)
    # late by the low passes at 476 Hz
    check(found, lever_arm=(0.2, max(2 * found["lever_arm"].half, 1e-3)), gyro_bias=(0.012, 1e-3),
          gyro_late=(1.0 / (2.0 * np.pi * 100.0), 5e-4), accel_late=(1.0 / (2.0 * np.pi * 211.0), 5e-4),
          **dict.fromkeys(("gyro_scale", "accel_scale_x", "accel_scale_y"), (0.0, 0.01)))
    assert found.after[1, 0] < 0.5 * found.before[1, 0]


@pytest.mark.skipif(not RECORD.is_file(), reason="the shared real records are not next to the checkout")
def test_a_public_record_of_an_imu_on_a_shaft(shell: Shell) -> None:
    """Against the figures in the data's README, found there by other means (low pass of 3 Hz, plain regression)."""
    rig = load_rig(RIGS / "song_imu.toml")
    found = compare([read_moving(RECORD, rig)], rig)
    check(found, gyro_scale=(-0.015, 0.0015), gyro_bias=(-0.0006, 0.001), gyro_late=(0.010, 0.003),
          accel_scale_x=(10.01 / G - 1.0, 0.04 / G), accel_scale_y=(9.88 / G - 1.0, 0.03 / G),
          accel_bias_x=(-0.20, 0.02), accel_bias_y=(0.02, 0.03), lever_arm=(0.0, 0.003))
    assert not found.lag_wanders
    assert (found.after[:, 0] < 0.5 * found.before[:, 0]).all()
    shell("calibrate imu-encoder", RECORD, "--rig", RIGS / "song_imu.toml", "--dry-run")
    assert "a CSV has calibrated ones" in shell.out


def test_without_a_sensor_at_the_pivot_nothing_is_recorded(shell: Shell) -> None:
    """It asked for a minute of swinging first."""
    shell("calibrate imu-encoder --rig", DEMO_RIG, status=2)
    said = shell.read()
    assert "the rig has no [devices.pivot]" in said.err and "swing" not in said.out
