"""The paper's free latents: derivatives, the paper's own numerical recipe, and what its result is worth."""

from dataclasses import replace

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark
from scipy.optimize import least_squares

from estimator import FitOptions, Method, fit
from estimator.fitting.mle_free import FreeProblem, build_problem, difference_matrix, first_latents, minimise
from estimator.model import leg2
from estimator.signals import lowpass, split_signals
from estimator.signals.filters import central_difference
from studies.biped3 import CASES
from studies.biped3.study import case_options, noisy_record
from studies.walker import motor_mechanism, one_step
from tests.support.mujoco_leg import Leg, record


def leg_problem(sensors: str, seconds: float) -> FreeProblem:
    leg = Leg()
    run = record(leg, default_rng(8), seconds=seconds)
    mechanism, options = leg2(lever_arm=leg.lever), FitOptions(sensors=sensors)
    return build_problem(split_signals([run], mechanism, options), mechanism, options)


def walker_problem(case: int) -> FreeProblem:
    mechanism, options = motor_mechanism(), case_options(CASES[case - 1])
    data = noisy_record(one_step().in_motor_angles(), CASES[case - 1], 31, 0)
    return build_problem(split_signals([data], mechanism, options), mechanism, options)


def test_difference_matrix_is_the_central_difference() -> None:
    x = default_rng(1).normal(size=12)
    assert_allclose((difference_matrix(12, 0.1) @ x)[1:-1], central_difference(x, 0.1)[1:-1])


def test_torque_goes_through_the_low_pass_of_34() -> None:
    """At the rig's cutoff; with the recipe of section V, which filters the absolute angle alone, only where it is asked
    for."""
    run = record(Leg(), default_rng(8), seconds=2.0)
    found = build_problem(split_signals([run], leg2(), FitOptions()), leg2(), FitOptions(cutoff_hz=6.0))
    assert_allclose(found.torque[:, 1], lowpass(run["tau2_nm"], 6.0, 100.0))
    mechanism, options = motor_mechanism(), case_options(CASES[2])
    walk = split_signals([noisy_record(one_step().in_motor_angles(), CASES[2], 31, 0)], mechanism, options)
    raw = build_problem(walk, mechanism, options).torque
    asked = build_problem(walk, mechanism, replace(options, torque_half_power=0.25)).torque
    assert_array_equal(raw[1:, 1], 0.5 * (walk[0].torque[1:, 1] + walk[0].torque[:-1, 1]))
    smooth, rough = (np.median(np.abs(np.diff(torque[:, 1], 3))) for torque in (asked, raw))
    assert smooth < 0.3 * rough


@mark.parametrize("sensors", ["imu", "encoder"])
def test_jacobian_is_the_derivative(sensors: str) -> None:
    problem = leg_problem(sensors, 0.6)
    w = first_latents(problem)
    beta = Leg().beta()
    latents, by_beta = problem.jacobian(w, beta)
    dense = latents.toarray()
    for k in default_rng(2).choice(w.size, 25, replace=False):
        d = np.zeros(w.size)
        d[k] = 1e-6
        numeric = (problem.residual(w + d, beta) - problem.residual(w - d, beta)) / 2e-6
        assert_allclose(dense[:, k], numeric, rtol=2e-4, atol=2e-4 * np.abs(dense[:, k]).max())
    for k in range(beta.size):
        d = np.zeros(beta.size)
        d[k] = 1e-6
        numeric = (problem.residual(w, beta + d) - problem.residual(w, beta - d)) / 2e-6
        assert_allclose(by_beta[:, k], numeric[: len(by_beta)], rtol=1e-5, atol=1e-5)


def test_minimum_agrees_with_a_general_solver() -> None:
    problem = walker_problem(2)
    found = minimise(problem, first_latents(problem))
    check = least_squares(problem.residual, first_latents(problem), x_scale="jac", xtol=1e-10, ftol=1e-10,
                          gtol=1e-10)
    assert found.converged
    assert found.objective == approx(2.0 * check.cost, rel=1e-6)
    assert_allclose(found.beta, problem.best_beta(problem.regressor(check.x)), rtol=1e-3)


@mark.parametrize("method, latent, close", [("mle", "free", 0.06), ("rls", "trajectory", 0.08)])
@mark.parametrize("sensors", ["imu", "encoder"])
def test_leg_is_found_as_well_as_differences_allow(sensors: str, method: Method, latent: str, close: float) -> None:
    leg = Leg()
    run = record(leg, default_rng(3))
    result = fit([run], leg2(lever_arm=leg.lever), FitOptions(sensors=sensors, latent=latent), method)
    assert result.method == method + "-free" * (latent == "free") and result.converged
    assert_allclose(result.beta[:5], leg.beta()[:5], rtol=close)
