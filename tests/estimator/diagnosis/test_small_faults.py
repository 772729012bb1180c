"""Small faults of sensors, put into readings of a leg that a Runge-Kutta integrator moves: taken off, or left."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng

from daq import Dataset
from estimator import FitError, FitOptions
from estimator.diagnosis import small_faults
from estimator.diagnosis.data_split import split_runs
from estimator.diagnosis.explanation import Explanation
from estimator.diagnosis.model import Model, nominal_model, refit
from estimator.diagnosis.small_faults import taken_in_words, without_small_faults
from estimator.effects.gyro_scale import GyroScale
from estimator.model import leg2
from estimator.signals import GYRO, SignalSet, encoder_of, torque_of
from tests.support.lab_readings import read_with
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.timed_leg import Timing, record

SMALL = {"gyro_scale": 0.011, "accelerometer_bias.x": 0.12, "accelerometer_bias.y": -0.09, "torque_offset": 0.006}
"""About one standard deviation of the default tolerances."""


@pytest.fixture(scope="module")
def plant() -> tuple[Leg, list[Dataset]]:
    rng = default_rng(12)
    leg = random_leg(rng)
    runs = [record(leg, rng, Timing(1000.0, 5), seconds=6.0, name=f"run{k}") for k in range(4)]
    return leg, [replace(run, columns={n: v for n, v in run.columns.items() if n != "q1_rad"}) for run in runs]


def fitted(plant: tuple[Leg, list[Dataset]], faults: Mapping[str, float],
           tolerances: Mapping[str, tuple[float, ...]] | None) -> Model:
    leg, runs = plant
    read = [read_with(run, faults) for run in runs]
    return nominal_model(split_runs(read, leg2(lever_arm=leg.lever), FitOptions(tolerances=tolerances)))


def test_what_is_taken_off_is_what_was_put_in(plant: tuple[Leg, list[Dataset]]) -> None:
    nominal = without_small_faults(fitted(plant, SMALL, {}))
    found = nominal.split
    (told,) = taken_in_words(nominal)
    assert "readings: accelerometer bias, bias x 0.12 m/s2; " in told and "encoder scale" not in told
    bias = found.taken["accelerometer_bias"]
    assert bias == pytest.approx([SMALL["accelerometer_bias.x"], SMALL["accelerometer_bias.y"]], rel=0.2)
    assert found.taken["gyro_scale"][0] == pytest.approx(SMALL["gyro_scale"], rel=0.4)
    assert found.taken["torque_offset"][0] == pytest.approx(SMALL["torque_offset"], rel=0.4)
    for clean in plant[1]:
        (signals,) = found.runs[found.names.index(clean.name)]
        read, n = read_with(clean, SMALL), len(signals.time_s)
        for column in ("accel_x_mps2", "accel_y_mps2"):
            put, left = (np.sqrt(np.mean((values[:n] - clean[column][:n]) ** 2))
                         for values in (read[column], signals.imu[column]))
            assert left < 0.25 * put


def test_a_fault_beyond_its_tolerance_leaves_all_to_the_search(plant: tuple[Leg, list[Dataset]]) -> None:
    nominal = fitted(plant, {**SMALL, "gyro_scale": 0.06}, {})
    assert without_small_faults(nominal) is nominal


def test_a_size_that_is_fitted_holds_what_was_taken_off(plant: tuple[Leg, list[Dataset]]) -> None:
    nominal = without_small_faults(fitted(plant, SMALL, {}))
    model = refit(nominal, [(GyroScale(), np.zeros(1))])
    own = Explanation(model, 0.0, inflation=np.ones(model.problem.parameter_count))
    assert abs(model.sizes()[0][0]) < 0.003
    assert own.sizes()[0][0] == pytest.approx(SMALL["gyro_scale"], abs=0.003)


@pytest.mark.parametrize("tolerances", [None, {"none": (0.0,)}])
def test_without_tolerances_readings_stay(plant: tuple[Leg, list[Dataset]],
                                          tolerances: Mapping[str, tuple[float, ...]] | None) -> None:
    nominal = fitted(plant, SMALL, tolerances)
    assert without_small_faults(nominal) is nominal and taken_in_words(nominal) == []


def test_a_run_whose_motion_is_not_found_leaves_all_readings(plant: tuple[Leg, list[Dataset]],
                                                             monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: object) -> None:
        raise FitError("no motion")

    nominal = fitted(plant, SMALL, {})
    monkeypatch.setattr(small_faults, "smooth", lost)
    assert without_small_faults(nominal) is nominal


@pytest.mark.parametrize(("stated", "bound_s", "skew_s"), [
    ({}, 2e-3, 1e-3), ({}, 1e-4, 3e-4), ({"none": (0.0,)}, 1e-4, 5e-5), ({"sensor_time_skew": (0.01,)}, 2e-3, 0.01)])
def test_what_clocks_leave_open_is_a_tolerance(plant: tuple[Leg, list[Dataset]], stated: dict[str, tuple[float, ...]],
                                               bound_s: float, skew_s: float) -> None:
    leg, runs = plant
    late = [replace(run, clock_bound_s=bound_s) for run in runs]
    found = split_runs(late, leg2(lever_arm=leg.lever), FitOptions(tolerances=stated)).tolerances
    assert found is not None and found["sensor_time_skew"] == pytest.approx((skew_s,))


def test_less_takes_each_reading_s_own_part_off() -> None:
    zero = np.zeros(3)
    signals = SignalSet("run", 100.0, np.arange(3) / 100.0, np.zeros((3, 2)), np.zeros((3, 2)),
                        {name: zero for name in ("gyro_radps", "accel_x_mps2", "accel_y_mps2")})
    left = signals.less({GYRO: zero + 1.0, encoder_of(1): zero + 2.0, torque_of(1): zero + 3.0})
    assert (left.imu["gyro_radps"] == -1.0).all() and (left.imu["accel_x_mps2"] == 0.0).all()
    assert (left.angles == [0.0, -2.0]).all() and (left.torque == [0.0, -3.0]).all()
    assert not signals.angles.any() and not signals.imu["gyro_radps"].any()
