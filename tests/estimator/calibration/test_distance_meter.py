"""The distance meter against the geometry of a ray and the ground."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, mark, raises

from daq import Dataset
from estimator import FitError, fit
from estimator.calibration import DistanceMeter, angle_record
from studies.biped3 import CASES
from studies.biped3.study import case_options, noisy_record, truth
from studies.walker import motor_mechanism, one_step

METER = DistanceMeter(mount_m=0.6, gamma_rad=0.5, sigma_m=1e-3, sigma_per_m=2e-3)


def ray_length(angle: float, meter: DistanceMeter) -> float:
    """Cast the beam by vectors: foot at the origin, x ahead, y up; the leg leans towards x by `angle`."""
    sensor = meter.mount_m * np.array([np.sin(angle), np.cos(angle)])
    down_the_leg = -sensor / meter.mount_m
    c, s = np.cos(meter.gamma_rad), np.sin(meter.gamma_rad)
    beam = np.array([[c, -s], [s, c]]) @ down_the_leg  # turned ahead
    return float(-sensor[1] / beam[1])


@mark.parametrize("angle", [-0.6, -0.2, -1e-3, 0.0, 1e-3, 0.2, 0.6])
def test_distance_is_the_length_of_the_ray(angle: float) -> None:
    assert METER.distance(np.array(angle)) == approx(ray_length(angle, METER), rel=1e-12)


def test_angle_inverts_distance_on_both_sides_of_upright() -> None:
    angles = np.linspace(-0.6, 0.9, 301)
    assert_allclose(METER.angle(METER.distance(angles)), angles, atol=1e-7)


def test_branches_meet_where_the_leg_is_upright() -> None:
    upright = METER.mount_m / np.cos(METER.gamma_rad)
    assert_allclose(METER.angle(np.array([upright * 0.999999, upright, upright * 1.000001])), 0, atol=1e-5)


def test_noise_grows_with_distance_and_reaches_the_angle_as_predicted() -> None:
    rng = np.random.default_rng(5)
    for angle in (-0.4, 0.1, 0.5):
        read = METER.read(np.full(40_000, angle), rng)
        distance = METER.distance(np.array(angle))
        assert np.std(read) == approx(1e-3 + 2e-3 * distance, rel=0.02)
        assert np.std(METER.angle(read)) == approx(METER.angle_sigma(distance), rel=0.03)


def test_a_beam_that_misses_the_ground_reads_infinity() -> None:
    assert np.isinf(METER.distance(np.array(-1.2)))


@mark.parametrize("wrong", [{"mount_m": 0.0, "gamma_rad": 0.5}, {"mount_m": 1.0, "gamma_rad": 1.6},
                                   {"mount_m": 1.0, "gamma_rad": 0.5, "sigma_m": -1.0}])
def test_impossible_geometry_is_refused(wrong: dict[str, float]) -> None:
    with raises(ValueError):
        DistanceMeter(**wrong)


MECHANISM, OPTIONS = motor_mechanism(), case_options(CASES[2])
GROWING = DistanceMeter(mount_m=0.6, gamma_rad=0.6, sigma_m=1e-5, sigma_per_m=4e-3)


def seen_by_the_meter(run: int) -> Dataset:
    step = one_step().in_motor_angles()
    data = noisy_record(step, CASES[0], 17, run)
    distance = GROWING.read(step.q[:, 0], np.random.default_rng([18, run]))
    columns = {name: values for name, values in data.columns.items() if name != "q1_rad"}
    return Dataset(data.name, data.rate_hz, data.time_s, {**columns, "distance_m": distance})


def test_walker_is_identified_through_the_meter_whose_noise_grows() -> None:
    """Errors over their reported deviations are those of chance, and smaller than where all readings count alike."""
    off, flat = [], []
    for run in range(30):
        record = angle_record(seen_by_the_meter(run), GROWING)
        level = float(np.sqrt(np.mean(record["q1_sigma_rad"] ** 2)))
        known = replace(OPTIONS, noise={**OPTIONS.noise, "encoder1_rad": level})
        result = fit([record], MECHANISM, known)
        off.append((result.beta - truth()) / result.std)
        alike = {name: values for name, values in record.columns.items() if name != "q1_sigma_rad"}
        flat.append((fit([replace(record, columns=alike)], MECHANISM, known).beta - truth()) / result.std)
    print(np.ptp(record["q1_sigma_rad"]) / level, np.sqrt(np.mean(np.square(off))), np.sqrt(np.mean(np.square(flat))))
    assert np.sqrt(np.mean(np.square(off))) == approx(1.0, abs=0.25)
    assert np.mean(np.square(off)) < 0.97 * np.mean(np.square(flat))


def test_the_step_search_weighs_readings_as_the_short_one_does() -> None:
    """Records too long for the search of short ones, or with unknown levels, go through `iterate`."""
    record = angle_record(seen_by_the_meter(3), GROWING)
    noise = {**OPTIONS.noise, "encoder1_rad": float(np.sqrt(np.mean(record["q1_sigma_rad"] ** 2)))}
    short = fit([record], MECHANISM, replace(OPTIONS, noise=noise))
    stepped = fit([record], MECHANISM, replace(OPTIONS, noise=noise, fixed={"beta2": float(short.beta[1])}))
    assert_allclose(stepped.beta, short.beta, rtol=0.02)


def test_a_beam_that_misses_is_refused() -> None:
    data = Dataset("run", 100.0, np.arange(3) / 100.0, {"distance_m": np.array([0.7, np.inf, 0.7])})
    with raises(FitError, match="missed the ground at 1 sample"):
        angle_record(data, METER)
    with raises(FitError, match="no column distance_m"):
        angle_record(Dataset("run", 100.0, np.arange(3) / 100.0, {"q1_rad": np.zeros(3)}), METER)
