"""A leg's record, spoilt as people spoil them: each spoilt column is named with what mends it, a whole one is not."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from pytest import approx, fixture, mark

from daq import Dataset, FloatArray
from estimator import FitOptions
from estimator.calibration import find_remedies, read_imu, wrong_lever
from estimator.model import chain, leg2
from estimator.signals import lowpass
from experiments.session import Suspicion, suspect
from tests.support.mujoco_leg import Leg, random_leg, record
from tests.support.mujoco_tree import disturbed, move, random_tree, torques

DEGREES = 180.0 / np.pi
Spoil = Mapping[str, Callable[[Dataset], np.ndarray]]


def negated(*columns: str) -> Spoil:
    return scaled(-1.0, *columns)


def scaled(factor: float, *columns: str) -> Spoil:
    def by_factor(column: str, data: Dataset) -> FloatArray:
        return factor * data[column]
    return {c: partial(by_factor, c) for c in columns}


@fixture(scope="module")
def leg_and_run() -> tuple[Leg, Dataset]:
    rng = np.random.default_rng(5)
    leg = random_leg(rng)
    return leg, record(leg, rng, seconds=10.0)


def spoilt(run: Dataset, by: Spoil) -> Dataset:
    return replace(run, columns={**run.columns, **{name: make(run) for name, make in by.items()}})


@mark.parametrize("by, named", [
    ({}, ""),
    (negated("tau2_nm"), "tau2_nm looks negated"),
    (negated("q2_rad"), "q2_rad looks negated"),
    (negated("q2_rad", "tau2_nm"), "negated"),  # the mirror image of one with q1_rad negated, where that is read
    (scaled(DEGREES, "q2_rad"), "q2_rad looks in degrees"),
    (scaled(1e3, "q2_rad"), "q2_rad looks in mrad"),
    (scaled(9.0, "q2_rad"), "q2_rad looks of the motor's side"),
    (scaled(1 / 9.0, "q2_rad"), "q2_rad looks divided by the gear ratio twice"),
    (scaled(1.25, "q2_rad"), "times too large"),
])
@mark.parametrize("sensors", ["imu", "encoder"])
def test_the_knees_columns(by: Spoil, named: str, sensors: str, leg_and_run: tuple[Leg, Dataset]) -> None:
    leg, run = leg_and_run
    now, found = find_remedies([spoilt(run, by)], leg2(lever_arm=leg.lever), FitOptions(sensors=sensors), 9.0)
    if named:
        assert named in found[0].remedy.what
        assert found[0].left < 0.5 * now.left or now.faults
    else:
        assert not found and not now.faults and now.left < 0.1


def test_counts_of_the_knees_encoder_are_measured(leg_and_run: tuple[Leg, Dataset]) -> None:
    leg, run = leg_and_run
    counts = spoilt(run, scaled(4096 / (2.0 * np.pi), "q2_rad"))
    _, found = find_remedies([counts], leg2(lever_arm=leg.lever), FitOptions(sensors="encoder"))
    assert "times too large" in found[0].remedy.what and "a count" in found[0].remedy.write
    assert found[0].remedy.angles[1, 1] == approx(2.0 * np.pi / 4096, rel=0.05)


@mark.parametrize("by, named", [
    ({"q1_rad": lambda d: d["q1_rad"] + np.pi}, "counted from upright"),
    (scaled(DEGREES, "q1_rad", "q2_rad"), "q1_rad and q2_rad look in degrees"),
    ({"q1_rad": lambda d: d["q2_rad"], "q2_rad": lambda d: d["q1_rad"]}, "interchanged"),
    ({"q2_rad": lambda d: d["q1_rad"] + d["q2_rad"]}, "look absolute"),
    (scaled(0.75, "q1_rad"), "q1_rad looks 1.3"),
])
def test_the_pivots_encoder(by: Spoil, named: str, leg_and_run: tuple[Leg, Dataset]) -> None:
    _, found = find_remedies([spoilt(leg_and_run[1], by)], leg2(), FitOptions(sensors="encoder"))
    assert named in found[0].remedy.what


def test_a_torque_of_the_wrong_scale_is_not_guessed_at(leg_and_run: tuple[Leg, Dataset]) -> None:
    """Every parameter scales with it: no motion shows it."""
    now, found = find_remedies([spoilt(leg_and_run[1], scaled(9.0, "tau2_nm"))], leg2(), FitOptions(sensors="encoder"))
    assert not found and not now.faults


@mark.parametrize("by, named", [
    (negated("accel_x_mps2"), ["accel_x_mps2 looks negated"]),
    (negated("accel_y_mps2"), ["accel_y_mps2 looks negated"]),
    (negated("gyro_radps"), ["gyro_radps looks negated"]),
    ({"accel_x_mps2": lambda d: d["accel_y_mps2"], "accel_y_mps2": lambda d: d["accel_x_mps2"]},
     ["accel_x_mps2 looks like accel_y_mps2", "accel_y_mps2 looks like accel_x_mps2"]),
    (scaled(DEGREES, "gyro_radps"), ["gyro_radps looks in degrees a second"]),
    (scaled(1e3 * DEGREES, "gyro_radps"), ["gyro_radps looks in mdps"]),
    (scaled(60.0 / (2.0 * np.pi), "gyro_radps"), ["gyro_radps looks in rpm"]),
    (scaled(1e3, "gyro_radps"), ["gyro_radps looks in mrad/s"]),
    (scaled(1.0 / DEGREES, "gyro_radps"), ["gyro_radps looks converted from degrees twice"]),
    (scaled(-DEGREES, "gyro_radps"), ["gyro_radps looks negated and in degrees a second"]),
    (scaled(1 / 9.80665, "accel_x_mps2", "accel_y_mps2"), ["accel_x_mps2 and accel_y_mps2 look in g"]),
    (scaled(1 / 9.80665, "accel_x_mps2"), ["accel_x_mps2 looks in g:"]),
    (scaled(1e3, "accel_x_mps2", "accel_y_mps2"), ["accel_x_mps2 and accel_y_mps2 look in mm/s2", 'unit = "mm/s2"']),
])
def test_the_imu_contradicts_itself(by: Spoil, named: list[str], leg_and_run: tuple[Leg, Dataset]) -> None:
    """Up to its mirror image, which the knee's equation tells apart."""
    leg, run = leg_and_run
    _, found = read_imu([spoilt(run, by)], leg.lever, 9.81)
    assert any(all(part in str(reading) for part in named) for reading in found[:2]), [str(r) for r in found]
    corrected = next(r for r in found if all(part in str(r) for part in named)).applied(spoilt(run, by))
    assert np.allclose(corrected["gyro_radps"], run["gyro_radps"])
    assert np.allclose(corrected["accel_x_mps2"], run["accel_x_mps2"])


def test_an_accelerometer_in_counts_is_measured_by_gravity(leg_and_run: tuple[Leg, Dataset]) -> None:
    leg, run = leg_and_run
    _, found = read_imu([spoilt(run, scaled(16384 / 9.81, "accel_x_mps2", "accel_y_mps2"))], leg.lever, 9.81)
    assert "times too large" in str(found[0]) and found[0].axes[0, 0] == approx(9.81 / 16384, rel=0.1)


def test_an_imu_that_is_right_and_one_whose_lever_arm_is_not(leg_and_run: tuple[Leg, Dataset]) -> None:
    leg, run = leg_and_run
    as_read, others = read_imu([run], leg.lever, 9.81)
    assert not others and not wrong_lever(as_read, leg.lever)
    standing = spoilt(run, {  # the same motion about upright
        "accel_x_mps2": lambda d: d["accel_x_mps2"] - 2.0 * 9.81 * np.sin(d["q1_rad"]),
        "accel_y_mps2": lambda d: d["accel_y_mps2"] + 2.0 * 9.81 * np.cos(d["q1_rad"])})
    assert read_imu([standing], leg.lever, 9.81)[1] and not read_imu([standing], leg.lever, 9.81, hangs=False)[1]
    said = wrong_lever(read_imu([run], 0.5 * leg.lever, 9.81)[0], 0.5 * leg.lever)
    assert "looks 0.2 m from the pivot" in said and "lever_arm_m" in said


@mark.parametrize("seed", [0, 6])
def test_an_accelerometer_that_whirls_is_read_as_it_stands(seed: int) -> None:
    """Most of the time it feels more than twice gravity."""
    rng = np.random.default_rng(seed)
    leg = random_leg(rng)
    run = record(leg, rng, seconds=10.0, amplitude=4.0, high=2.0)
    assert np.median(np.hypot(run["accel_x_mps2"], run["accel_y_mps2"])) > 2.0 * 9.81
    assert not read_imu([run], leg.lever, 9.81)[1]


@mark.parametrize("columns, named", [
    (["accel_x_mps2"], "accel_x_mps2 looks negated: "), (["gyro_radps"], "gyro_radps looks negated: ")])
def test_the_knee_tells_a_reading_from_its_mirror_image(columns: list[str], named: str,
                                                        leg_and_run: tuple[Leg, Dataset]) -> None:
    leg, run = leg_and_run
    found = suspect([spoilt(run, negated(*columns))], leg2(lever_arm=leg.lever), FitOptions(sensors="imu"), 1.0, True)
    assert found.remedies[0].startswith(named) and found.against
    assert "tau2_nm" not in found.remedies[0] and "q2_rad" not in found.remedies[0]
    assert suspect([run], leg2(lever_arm=leg.lever), FitOptions(sensors="imu"), 1.0, False) == Suspicion()


def chain_of_three(seed: int, seconds: float, share: float, third: float = 1.0, coulomb: float = 0.1) -> Dataset:
    """MuJoCo's chain, joints 2 and 3 driven, the third with a torque `third` times as large."""
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, (-1, 0, 1), coulomb=coulomb)
    if third < 1.0:
        tree = tree._replace(coulomb=tree.coulomb * np.array([0.2, 1.0, 4.0]))
        tau = torques(tree, rng, seconds, 100.0, share, (1,)) + third * torques(tree, rng, seconds, 100.0, share, (2,))
    else:
        tau = torques(tree, rng, seconds, 100.0, share, (1, 2))
    return disturbed(move(tree, tau, 100.0, start=([0.8, 0.2, 0.1], [0.0] * 3)), (1, 2), 100.0, rng)


@mark.parametrize("seed", [1, 7])
def test_a_joint_that_hardly_turns_is_read_as_it_stands(seed: int) -> None:
    """Its friction holds it to 0.02 rad; with the sign turned the residual is a third larger."""
    run, mechanism = chain_of_three(seed, 3.0, 0.5, 0.7, 0.3), chain(3, actuated=(1, 2))
    now, found = find_remedies([run], mechanism, FitOptions(sensors="encoder"))
    assert np.ptp(run["q3_rad"]) < 0.05 and not now.faults and not found
    assert suspect([run], mechanism, FitOptions(sensors="encoder"), 1.0, True) == Suspicion()


@mark.parametrize("seed, seconds", [(81, 2.0), (84, 2.0), (87, 3.0)])
def test_a_factor_that_predicts_no_other_part_of_the_record_is_not_named(seed: int, seconds: float) -> None:
    """A gear's friction of 1 N m that grows with the torque: a factor of 1.3 imitates it in 2 s."""
    run = chain_of_three(seed, seconds, 0.4)
    rate = lowpass(np.gradient(run["q3_rad"], 0.01), 15.0, 100.0)
    rubbing = spoilt(run, {"tau3_nm": lambda d: d["tau3_nm"] + np.tanh(rate / 0.5) * (1.0 + np.abs(d["tau3_nm"]))})
    assert not find_remedies([rubbing], chain(3, actuated=(1, 2)), FitOptions(sensors="encoder"))[1]


@mark.parametrize("by, named", [
    (scaled(1.0 / 0.6, "q3_rad"), "q3_rad looks 1.6"), (scaled(DEGREES, "q3_rad"), "q3_rad looks in degrees"),
    (negated("tau2_nm"), "tau2_nm looks negated")])
def test_a_chain_that_moves_shows_its_columns(by: Spoil, named: str) -> None:
    run = spoilt(chain_of_three(52, 8.0, 0.5), by)
    _, found = find_remedies([run], chain(3, actuated=(1, 2)), FitOptions(sensors="encoder"))
    assert found[0].remedy.what.startswith(named)
