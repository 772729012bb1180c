"""Torque between samples that no sample shows: its rows and likelihood against differences, its level on PD legs."""

from dataclasses import replace

import numpy as np
from numpy.random import default_rng
from pytest import approx, mark

from daq import Dataset
from estimator import FitOptions, fit
from estimator.fitting import converge_motion
from estimator.fitting.torque_colour import torque_colour
from estimator.likelihood import GaussRows, LatentProblem, Latents, Noise, State, log_marginal, unseen_level
from estimator.model import leg2
from estimator.numerics import eliminate
from estimator.signals import split_signals
from tests.support.dense_chain import at_measured, dense, residual_colour
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.mujoco_leg import record as in_mujoco
from tests.support.timed_leg import Timing, record

SMOOTH = Leg(coulomb=(0.0, 0.0))
LEVEL = 0.05


def small() -> tuple[LatentProblem, State, Dataset]:
    """A record of 2 s without dry friction, at the likeliest motion under LEVEL at the knee."""
    mechanism = leg2(lever_arm=SMOOTH.lever)
    data = in_mujoco(SMOOTH, default_rng(9), rate_hz=100.0, seconds=2.0)
    problem = LatentProblem(split_signals([data], mechanism, FitOptions()), mechanism, "zero")
    noise = Noise(np.array([0.001, 0.01]), np.array([np.inf, 3e-4]), np.array([0.005]), np.full((1, 2), 0.1),
                  unseen=np.array([0.0, LEVEL]))
    return problem, converge_motion(problem, at_measured(problem, data, SMOOTH.beta(), noise), 40), data


def rows_at(problem: LatentProblem, x: Latents, beta: np.ndarray) -> GaussRows:
    return GaussRows(problem, x, beta, None)


def test_rows_are_the_residual_s_differences() -> None:
    problem, state, _ = small()
    rows, rng = rows_at(problem, state.x, state.beta), default_rng(0)
    step = 1e-6 * rng.normal(size=(problem.total, problem.block))
    change = (rows_at(problem, state.x.moved(step), state.beta).residual
              - rows_at(problem, state.x.moved(-step), state.beta).residual) / 2.0
    for j in range(problem.n):
        both = np.concatenate([step[problem.left], step[problem.left + 1]], axis=1)
        told = np.einsum("gki,ki->gk", rows.of(j, slice(None)), both)
        assert told == approx(change[j], abs=1e-5 * float(np.abs(change[j]).max()))
    assert rows.ahead().shape == (problem.left.size, 4, 4)


def test_what_the_latents_follow_is_that_of_the_dense_inverse() -> None:
    problem, state, _ = small()
    rows = rows_at(problem, state.x, state.beta)
    chain = problem.motion_equations(state.x, state.beta, state.noise).chain
    covariance = np.linalg.inv(dense(chain))
    followed = rows.followed(eliminate(problem.motion_equations(state.x, state.beta, state.noise).chain), 1)
    for k in (0, 17, problem.left.size - 1):
        b, row = problem.block, rows.of(1, slice(k, k + 1))[:, 0]
        own = covariance[k * b : (k + 2) * b, k * b : (k + 2) * b]
        assert followed[:, k] == approx(np.diag(row @ own @ row.T), rel=1e-4)


def test_the_level_is_where_the_likelihood_does_not_rise() -> None:
    """d log p / d log sigma is half of sum (r^2 + J P J^T) / sigma^2 - count, by Fisher's identity, and the level is
    its zero."""
    problem, state, _ = small()

    def at(level: float) -> State:
        return converge_motion(problem, replace(state, noise=replace(state.noise, unseen=np.array([0.0, level]))), 40)

    step = 0.01
    slope = (log_marginal(problem, at(LEVEL * np.exp(step))) - log_marginal(problem, at(LEVEL * np.exp(-step)))
             ) / (2.0 * step)
    here = at(LEVEL)
    solved = eliminate(problem.motion_equations(here.x, here.beta, here.noise).chain)
    rows = rows_at(problem, here.x, here.beta)
    variance = float(problem.motion_level(here.noise)[1, 0]) ** 2
    told = float(np.sum((rows.residual[1] ** 2 + rows.followed(solved, 1)) / variance - 1.0))
    assert slope == approx(told * LEVEL**2 / variance, rel=0.02)
    for _ in range(60):
        solved = eliminate(problem.motion_equations(here.x, here.beta, here.noise).chain)
        here = at(float(unseen_level(problem, here.x, here.beta, here.noise, solved)[1]))
    best = float(here.noise.unseen[1])
    assert log_marginal(problem, here) > max(log_marginal(problem, at(best * f)) for f in (0.7, 1.4))


def test_the_torque_s_colour_knows_of_it() -> None:
    """Against R - H P H^T, to which it adds nothing: the samples' noise is their sensor's."""
    problem, state, data = small()
    found = torque_colour(problem, state, split_signals([data], problem.mechanism, FitOptions()))
    assert found[1] == approx(residual_colour(problem, state, 0.01), abs=0.1)


@mark.parametrize("loop, counts, there", [("pd", 4096, True), ("open", 4096, False)])
def test_a_loop_faster_than_the_log_leaves_sensors_their_noise(loop: str, counts: int, there: bool) -> None:
    """By an integrator of its own: torque 0.01 N m, gyro 0.005 rad/s, accelerometer 0.05 m/s2."""
    rng = default_rng(31)
    leg, timing = random_leg(rng), Timing(500.0, log_every=2, loop=loop)
    runs = [record(leg, rng, timing, seconds=6.0, counts=counts, name=f"r{k}") for k in range(2)]
    found = fit(runs, leg2(lever_arm=leg.lever), options=FitOptions())
    assert ("unseen2_nm" in found.noise) is there
    assert any("no sample shows" in text for text in found.assumptions) is there
    assert 0.7 < found.noise["torque_nm"] / 0.01 < 1.4 and 0.7 < found.noise["accel_mps2"] / 0.05 < 1.4
    assert np.abs(found.beta[:5] / leg.beta()[:5] - 1.0).max() < 0.015
