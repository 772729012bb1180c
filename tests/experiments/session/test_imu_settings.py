"""The age of an IMU by its settings in rig.toml, against a plant whose IMU has a low pass and arrives late."""

import numpy as np
import pytest

import legid
from daq import Dataset, InputError, parse_rig
from experiments.session import prepare
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.timed_leg import Timing, record

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
