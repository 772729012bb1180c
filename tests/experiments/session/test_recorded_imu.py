"""The age of an IMU as the recorder states it: an emulated chip behind its low passes, recorded and fitted."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import legid
from daq import Dataset, InputError, Rig, parse_rig
from daq.runs import RawRun, read_run
from daq.timing import align
from experiments.emulation import LegBody, record_emulated
from experiments.excite import random_multisine
from experiments.session import prepare
from tests.support.paths import DEMO_RIG

GYRO_HZ, ACCEL_HZ = 76.0, 105.0
"""-3 dB points at 238 Hz, by the data sheet."""
GYRO_S = 1.0 / (2.0 * np.pi * GYRO_HZ)
"""Age of the emulated gyro, whose low pass is of first order."""
TEXT = DEMO_RIG.read_text(encoding="utf-8").replace("rate_hz = 476.0", "rate_hz = 238.0")


@pytest.fixture(scope="module")
def rig() -> Rig:
    return parse_rig(TEXT)


@pytest.fixture(scope="module")
def recorded(rig: Rig, module_path: Path) -> list[RawRun]:
    for seed in (40, 41):
        record_emulated(module_path / f"{seed}.mcap", rig, TEXT, random_multisine(seed, 10.0, 0.7), seed)
    return [read_run(path) for path in sorted(module_path.glob("*.mcap"))]


@pytest.fixture(scope="module")
def runs(rig: Rig, recorded: list[RawRun]) -> list[Dataset]:
    """As they were recorded: no reading is moved yet."""
    return [align(raw, rig) for raw in recorded]


def skew_s(found: legid.FitResult) -> float:
    """How late the readings were against encoder and torque after they had been moved, as the fit tells it [s]."""
    (told,) = (re.search(r"the IMU is ([\d.]+) (us|ms) (late|early) against", text) for text in found.assumptions
               if "the IMU is" in text)
    assert told is not None
    return float(told[1]) * {"us": 1e-6, "ms": 1e-3}[told[2]] * (1.0 if told[3] == "late" else -1.0)


def test_gyro_and_accelerometer_are_moved_each_by_its_own_age(rig: Rig, runs: list[Dataset]) -> None:
    raw = runs[0]
    assert raw.imu.ages is not None
    assert (raw.imu.cutoff_hz, raw.imu.odr_hz, raw.imu.stamped) == ((GYRO_HZ, ACCEL_HZ), 238.0, "sample")
    setup = prepare([raw], rig).setup
    (moved,) = setup.datasets
    assert moved.imu_age_s == raw.imu.ages[0].mean_s
    assert setup.tolerances is not None
    assert setup.tolerances["sensor_time_skew"] == (raw.imu.ages[0].std_s,)
    inner = slice(50, -50)
    for name, age in zip(("gyro_radps", "accel_x_mps2"), raw.imu.ages, strict=True):
        slope = np.gradient(raw[name], raw.time_s)[inner]
        ahead_s = float(slope @ (moved[name] - raw[name])[inner] / (slope @ slope))
        assert ahead_s == pytest.approx(age.mean_s, rel=0.1), name


def test_the_rig_file_goes_before_the_recorder(runs: list[Dataset]) -> None:
    stated = parse_rig(TEXT.replace("[imu]", '[imu]\ncutoff_hz = 50.0\nstamped = "sample"'))
    setup = prepare(runs[:1], stated).setup
    (age, _) = stated.imus[0].ages or (None, None)
    assert setup.datasets[0].imu_age_s == age.mean_s
    assert setup.tolerances is not None and setup.tolerances["sensor_time_skew"] == (age.std_s,)
    with pytest.raises(InputError, match="cutoff_hz has 3 numbers"):
        parse_rig(TEXT.replace("[imu]", "[imu]\ncutoff_hz = [50.0, 50.0, 50.0]"))


@pytest.mark.parametrize("cutoff_hz, fault", [
    ("[76.0, -1.0]", "settings of its IMU that cannot be"), ("[76.0]", "cutoff_hz has 1 numbers")])
def test_a_run_with_settings_that_no_chip_has_is_refused(rig: Rig, recorded: list[RawRun], cutoff_hz: str, fault: str
                                                         ) -> None:
    config = [note._replace(text=note.text.replace("[76.0,105.0]", cutoff_hz)) for note in recorded[0].config]
    with pytest.raises(InputError, match=fault):
        align(replace(recorded[0], config=config), rig)


def test_a_run_of_an_earlier_version_states_no_age(rig: Rig, recorded: list[RawRun]) -> None:
    config = [note._replace(text=re.sub(r',"cutoff_hz.*"sample"', "", note.text)) for note in recorded[0].config]
    (used,) = prepare([align(replace(recorded[0], config=config), rig)], rig).setup.datasets
    assert used.imu is None and used.imu_age_s is None


def test_a_fit_has_the_age_inside_its_interval_and_agrees_with_one_that_is_not_told(rig: Rig, runs: list[Dataset]
                                                                                    ) -> None:
    assert runs[0].imu.ages is not None
    nominal, _ = runs[0].imu.ages
    told = legid.fit(runs, rig)
    # what a file of another program is: neither the low passes nor any clock is known
    untold = legid.fit([replace(run, imu=None, clock_bound_s=0.0) for run in runs], rig)
    assert abs(GYRO_S - nominal.mean_s) < 2.0 * nominal.std_s
    assert nominal.mean_s + skew_s(told) == pytest.approx(GYRO_S, abs=2e-4)
    assert skew_s(untold) == pytest.approx(nominal.mean_s + skew_s(told), abs=2e-4)
    truth = LegBody(gravity=rig.mechanism.gravity_mps2).beta()
    for found in (told, untold):
        low, high = found.ci95().T
        assert np.all((low <= truth) & (truth <= high))
        assert found.beta[5] == pytest.approx(truth[5], rel=0.15)  # 0 where the readings stay late
