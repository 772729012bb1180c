"""Times that rig.toml or the recorder states: delays of a torque, ages of an IMU; plants have times of their own."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import legid
from daq import Dataset, InputError, Rig, parse_rig
from daq.runs import RawRun, read_run
from daq.timing import align
from experiments.emulation import LegBody, record_emulated
from experiments.excite import random_multisine
from experiments.session import prepare, with_delay
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.paths import DEMO_RIG
from tests.support.timed_leg import Timing, record

LEG_RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = 0.2\n'


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
    rig = parse_rig(LEG_RIG + "[timing]\ntorque_delay_s = [0.007, 0.0005]\n")
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
    rig = parse_rig(LEG_RIG + f"[timing]\ncontrol_period_s = {period_s}\n")
    assert prepare([run], rig).setup.options.hold == hold


RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\n'
CUTOFF_HZ, ODR_HZ = 50.0, 238.0
SETTINGS = f'odr_hz = {ODR_HZ}\ncutoff_hz = {CUTOFF_HZ}\nstamped = "arrival"\n'


def runs_of(age_s: float, count: int = 2) -> tuple[Leg, list[Dataset]]:
    """Runs of a leg whose IMU has a low pass of first order and arrives `age_s` later."""
    rng = np.random.default_rng(12)
    leg = random_leg(rng)
    timing = Timing(1000, 5, loop="pd", imu_age_s=age_s, imu_cutoff_hz=CUTOFF_HZ)
    return leg, [record(leg, rng, timing, name=f"run{k}") for k in range(count)]


@pytest.mark.parametrize("settings, least_s, most_s", [
    (f"cutoff_hz = {CUTOFF_HZ}\n", 1.0 / (2.0 * np.pi * CUTOFF_HZ), np.sqrt(2.0) / (2.0 * np.pi * CUTOFF_HZ)),
    (f'odr_hz = {ODR_HZ}\nstamped = "arrival"\n', 0.5 / ODR_HZ, 1.0 / ODR_HZ),
    (f'odr_hz = {ODR_HZ}\nstamped = "sample"\n', 0.0, 0.0)])
def test_the_nominal_age_is_between_those_of_both_orders_and_both_arrivals(settings: str, least_s: float, most_s: float
                                                                           ) -> None:
    ages = parse_rig(RIG + settings).imus[0].ages
    assert ages is not None and ages[0] == ages[1]
    age = ages[0]
    assert age.mean_s == pytest.approx(0.5 * (least_s + most_s))
    assert age.mean_s - age.std_s <= least_s and most_s <= age.mean_s + age.std_s


def test_a_rig_that_says_nothing_of_it_has_no_age() -> None:
    rig = parse_rig(RIG + f"odr_hz = {ODR_HZ}\n")
    assert rig.imus[0].ages is None and "sensor_time_skew" not in rig.tolerances
    assert parse_rig(RIG + SETTINGS).tolerances["sensor_time_skew"] == pytest.approx((1.27e-3,), abs=2e-5)
    with pytest.raises(InputError, match="odr_hz"):
        parse_rig(RIG + 'stamped = "arrival"\n')


def test_readings_are_moved_once_and_what_was_not_read_is_a_gap() -> None:
    leg, runs = runs_of(0.0, 1)
    rig = parse_rig(RIG + f"lever_arm_m = {leg.lever}\n" + SETTINGS)
    (moved,) = prepare(runs, rig).setup.datasets
    assert rig.imus[0].ages is not None
    age, _ = rig.imus[0].ages
    assert moved.imu_age_s == age.mean_s and moved.clock_bound_s == 2.0 * age.std_s
    (again,) = prepare([moved], rig).setup.datasets
    np.testing.assert_array_equal(again["gyro_radps"], moved["gyro_radps"])
    lost = int(np.ceil(age.mean_s * moved.rate_hz))
    assert np.isnan(moved["accel_x_mps2"][-lost:]).all() and np.isfinite(moved["accel_x_mps2"][:-lost]).all()
    slow = np.interp(moved.time_s[:-lost] + age.mean_s, runs[0].time_s, runs[0]["gyro_radps"])
    assert np.std(moved["gyro_radps"][:-lost] - slow) < 0.01
    np.testing.assert_array_equal(moved["q2_rad"], runs[0]["q2_rad"])


def test_a_fit_finds_the_rest_of_the_age_within_the_tolerance_of_the_settings() -> None:
    leg, runs = runs_of(0.003)  # 6.2 ms with the low pass, 7.0 +- 1.3 by the settings
    found = legid.fit(runs, parse_rig(RIG + f"lever_arm_m = {leg.lever}\n" + SETTINGS))
    low, high = found.ci95().T
    assert np.all((low <= leg.beta())[:5] & (leg.beta() <= high)[:5])
    assert found.beta[5] == pytest.approx(leg.beta()[5], rel=0.3)
    (told,) = (text for text in found.assumptions if "early against the controller" in text)
    assert "corrected" in told and float(told.split()[3]) == pytest.approx(800.0, abs=250.0)


@pytest.mark.slow
@pytest.mark.parametrize("age_s, beyond_s", [(0.003, None), (0.011, 0.0072)])
def test_a_diagnosis_names_what_is_beyond_the_nominal_age_alone(age_s: float, beyond_s: float | None) -> None:
    leg, runs = runs_of(age_s, 4)
    some = [run.part(slice(0, 1000)) for run in runs]
    found = legid.diagnose(some, parse_rig(RIG + f"lever_arm_m = {leg.lever}\n" + SETTINGS))
    late = [s.value for c in found.causes if c.effect == "sensor_time_skew" for s in c.size if s.name == "skew"]
    assert found.verdict == ("none" if beyond_s is None else "named")
    assert late == ([] if beyond_s is None else [pytest.approx(beyond_s, abs=1e-3)])


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
