"""Rehearsals have the noise of the records: each axis' own level, and what is declared of correlations."""

import numpy as np
from pytest import approx

from estimator import FitOptions
from estimator.diagnosis.data_split import split_runs
from estimator.diagnosis.model import nominal_model
from estimator.model import leg2
from estimator.prediction import draw_replicate, simulate_run
from tests.support.mujoco_leg import random_leg, record
from tests.support.prescribed import arm_run

DRAWS = 6
"""Of some 2000 samples: standard deviations to 1 %, correlations to 0.01."""


def test_axes_of_a_replicate_have_their_levels_and_correlation() -> None:
    rng = np.random.default_rng(3)
    leg = random_leg(rng)
    run = record(leg, rng, seconds=20.0)
    other = 0.15 * (0.8 * rng.normal(size=len(run)))
    run.columns["accel_y_mps2"][:] += other
    options = FitOptions(sensors="imu", accel_correlation=0.6)
    split = split_runs([run], leg2(lever_arm=leg.lever), options)
    model = nominal_model(split)
    noise, signals = model.state.noise, split.signals(split.train)
    assert noise.accel_correlation == 0.6 and noise.accel[0, 1] > 1.5 * noise.accel[0, 0]
    truth = simulate_run(model.problem, model.state, rng)
    drawn = np.array([[np.concatenate([s.imu[c] for s in replicate]) for c in ("accel_x_mps2", "accel_y_mps2")]
                      for replicate in (draw_replicate(model.problem, model.state, signals, rng, truth)
                                        for _ in range(DRAWS))])
    left = (drawn - drawn.mean(axis=0)).transpose(1, 0, 2).reshape(2, -1)
    assert np.sqrt(DRAWS / (DRAWS - 1)) * left.std(axis=1) == approx(noise.accel[0], rel=0.03)
    assert np.corrcoef(left)[0, 1] == approx(0.6, abs=0.03)


def test_torques_of_a_replicate_correlate_as_declared() -> None:
    options = FitOptions(sensors="encoder", torque_correlation=((1.0, -0.5), (-0.5, 1.0)))
    split = split_runs([arm_run(1, seconds=20.0)], leg2(actuated=(0, 1)), options)
    model = nominal_model(split)
    rng, signals = np.random.default_rng(4), split.signals(split.train)
    truth = simulate_run(model.problem, model.state, rng)
    replicates = [draw_replicate(model.problem, model.state, signals, rng, truth) for _ in range(DRAWS)]
    drawn = np.array([np.concatenate([s.torque for s in replicate]) for replicate in replicates])
    left = (drawn - drawn.mean(axis=0)).reshape(-1, 2)
    assert np.corrcoef(left.T)[0, 1] == approx(-0.5, abs=0.03)
    assert np.sqrt(DRAWS / (DRAWS - 1)) * left.std(axis=0) == approx(model.state.noise.torque, rel=0.03)
