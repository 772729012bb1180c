"""The default estimator on legs that MuJoCo simulated; seeds 500 and up were not used while building it."""

import numpy as np
import pytest
from numpy.random import default_rng

from daq import Dataset
from estimator import FitError, FitOptions, Method, fit
from estimator.model import leg2, simulate
from tests.support.mujoco_leg import Leg, random_leg, record

RIGID = slice(0, 5)


@pytest.fixture(scope="module")
def legs() -> list[tuple[Leg, Dataset, Dataset]]:
    out = []
    for seed in range(500, 505):
        rng = default_rng(seed)
        leg = random_leg(rng)
        run = record(leg, rng, name="fit")
        out.append((leg, run, record(leg, rng, name="check") if seed < 503 else run))  # who checks, checks three
    return out


def test_imu_path_finds_inertia_and_gravity_within_one_per_cent(legs: list[tuple[Leg, Dataset, Dataset]]) -> None:
    errors, inside = [], []
    for leg, run, _ in legs:
        found = fit([run], leg2(lever_arm=leg.lever), FitOptions(sensors="imu"))
        assert found.converged
        truth = leg.beta()
        errors.append(np.abs(found.beta[RIGID] / truth[RIGID] - 1))
        low, high = found.ci95().T
        inside.append((low <= truth) & (truth <= high))
        assert 0.015 < found.noise["torque_nm"] < 0.025
        assert 0.004 < found.noise["gyro_radps"] < 0.006
    assert np.median(errors) < 0.005
    assert np.max(np.median(errors, axis=0)) < 0.01
    assert np.mean(inside) > 0.75


def test_table_v_shape_holds(legs: list[tuple[Leg, Dataset, Dataset]]) -> None:
    """Free runs from rest under the measured torque, by what is above the true parameters' own error: MLE leaves less
    than a quarter of every other method's."""
    sums = {"mle-imu": 0.0, "wls-imu": 0.0, "wls-hall": 0.0, "free-imu": 0.0}
    for leg, run, check in legs[:3]:
        mechanism = leg2(lever_arm=leg.lever)
        torque = np.column_stack([np.zeros(len(check)), check["tau2_nm"]])
        truth, _, _ = simulate(mechanism, leg.beta(), np.zeros(2), np.zeros(2), torque, check.dt_s)
        for key in sums:
            method, sensors = key.split("-")
            options = FitOptions(sensors="imu" if sensors == "imu" else "encoder",
                                 latent="free" if method == "free" else "trajectory")
            by: Method = "wls" if method == "wls" else "mle"
            found = fit([run], mechanism, options, by)
            q, _, _ = simulate(mechanism, found.beta, np.zeros(2), np.zeros(2), torque, check.dt_s)
            sums[key] += float(np.sum((q - truth) ** 2))
    assert all(sums["mle-imu"] < 0.25 * other for key, other in sums.items() if key != "mle-imu"), sums


def test_imu_path_never_reads_the_pivot_encoder(legs: list[tuple[Leg, Dataset, Dataset]]) -> None:
    leg, run, _ = legs[0]
    columns = {k: v for k, v in run.columns.items() if k != "q1_rad"}
    without = Dataset(run.name, run.rate_hz, run.time_s, columns)
    options = FitOptions(sensors="imu")
    a, b = (fit([d], leg2(lever_arm=leg.lever), options) for d in (run, without))
    np.testing.assert_array_equal(a.beta, b.beta)


@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_the_hold_is_part_of_the_model(hold: str) -> None:
    leg = Leg()
    run = record(leg, default_rng(510), seconds=12, hold=hold, high=8.0)
    right = fit([run], leg2(lever_arm=leg.lever), FitOptions(sensors="imu", hold=hold))
    wrong = "linear" if hold == "zero" else "zero"
    other = fit([run], leg2(lever_arm=leg.lever), FitOptions(sensors="imu", hold=wrong))
    truth = leg.beta()[RIGID]
    assert np.max(np.abs(right.beta[RIGID] / truth - 1)) < 0.02
    assert np.linalg.norm(right.beta[RIGID] / truth - 1) < np.linalg.norm(other.beta[RIGID] / truth - 1)


def test_a_fixed_parameter_sets_the_scale_of_a_free_swing() -> None:
    leg = Leg(viscous=(0.002, 0.002), coulomb=(0.002, 0.001))
    tau = np.concatenate([np.full(100, 1.2), np.zeros(1900)])
    run = record(leg, default_rng(511), tau=tau, torque=0.0)
    swing = run.part(slice(110, 2000))
    options = FitOptions(sensors="encoder")
    with pytest.raises(FitError, match="--fix"):
        fit([Dataset("swing", 100.0, swing.time_s, {**swing.columns, "tau2_nm": np.zeros(len(swing))})],
            leg2(actuated=()), options)
    found = fit([swing], leg2(actuated=()), FitOptions(sensors="encoder", fixed={"beta5": float(leg.beta()[4])}))
    assert found.beta[4] == leg.beta()[4]
    assert np.max(np.abs(found.beta[RIGID] / leg.beta()[RIGID] - 1)) < 0.02


def test_a_gap_splits_a_run_instead_of_being_filled(legs: list[tuple[Leg, Dataset, Dataset]]) -> None:
    leg, run, _ = legs[1]
    columns = {k: v.copy() for k, v in run.columns.items()}
    for values in columns.values():
        values[700:760] = np.nan
    found = fit([Dataset("holed", 100.0, run.time_s, columns)], leg2(lever_arm=leg.lever), FitOptions())
    assert found.samples == 2000 - 60
    assert len(found.trajectories) == 2
    assert np.max(np.abs(found.beta[RIGID] / leg.beta()[RIGID] - 1)) < 0.015
