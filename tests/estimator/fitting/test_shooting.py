"""Multiple shooting against closed forms, finite differences, MuJoCo, and drives with errors that no fit knows of."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import MonkeyPatch, fixture, mark

from daq import Dataset, FloatArray
from estimator import MOST_DISAGREEMENT, FitOptions, FitResult
from estimator.fitting import fit_admissible, second_opinion, with_second_opinion
from estimator.fitting.fit import estimate
from estimator.fitting.second_opinion import shoot_from
from estimator.fitting.shooting import Shot
from estimator.fitting.shooting_segments import Segments
from estimator.model import Mechanism, joint1, leg2, simulate
from estimator.result import HeldOut
from estimator.signals import split_signals
from tests.support.free_swing import swing
from tests.support.geared_pendulum import GearedPendulum
from tests.support.geared_pendulum import record as record_geared
from tests.support.mujoco_leg import Leg, random_leg, record

ENCODER = FitOptions(sensors="encoder", encoders=(0,))


def shot_of(runs: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> tuple[FitResult, Shot]:
    result = estimate(runs, mechanism, options, "mle")
    return result, shoot_from(runs, result.mechanism, replace(options, hold=result.hold), result)


def axis_run(inertia: float, viscous: float) -> Dataset:
    """A wheel with viscous friction under a torque held from sample to sample: its motion in closed form."""
    rng, n, h = default_rng(5), 1500, 0.01
    torque = np.repeat(rng.normal(size=n // 15), 15)
    q, v = np.zeros(n), np.zeros(n)
    decay, end = np.exp(-viscous / inertia * h), torque / viscous
    for k in range(n - 1):
        v[k + 1] = end[k] + (v[k] - end[k]) * decay
        q[k + 1] = q[k] + end[k] * h + (v[k] - end[k]) * inertia / viscous * (1.0 - decay)
    return Dataset("axis", 100.0, np.arange(n) / 100.0, {"q1_rad": q + 1e-7 * rng.normal(size=n), "tau1_nm": torque})


def test_a_wheel_of_closed_form_is_found_to_the_noise() -> None:
    mechanism = joint1(gravity_mps2=0.0)
    options = replace(ENCODER, hold="zero", fixed={"beta3": 0.0})
    _, shot = shot_of([axis_run(0.02, 0.05)], mechanism, options)
    assert_allclose(shot.beta, [0.02, 0.05, 0.0], rtol=1e-5)
    assert shot.half_width[2] == 0.0 and shot.lost == 0


def motion_of(segments: Segments, beta: FloatArray, q: FloatArray, v: FloatArray) -> FloatArray:
    *found, good = segments.simulate(q, v, beta)
    assert good.all()
    return np.concatenate(found, axis=1)


@mark.parametrize("sensors", ["imu", "encoder"])
def test_sensitivities_are_those_of_differences_and_residuals_move_by_them(sensors: str) -> None:
    leg = replace(Leg(), coulomb=(0.0, 0.0))
    data = record(leg, default_rng(1), seconds=4.0)
    mechanism, options = leg2(lever_arm=leg.lever), FitOptions(sensors=sensors)
    segments = Segments(split_signals([data], mechanism, options), mechanism, "linear", 1.0)
    q = np.stack([data["q1_rad"], data["q2_rad"]], axis=1)
    v, beta, free = np.gradient(q, 0.01, axis=0), leg.beta(), np.ones(9, dtype=bool)
    x = motion_of(segments, beta, q, v)
    linear = segments.linearise(x[:, :2], x[:, 2:], beta, free)
    for k in (0, 2, 4, 6):
        step = np.zeros(9)
        step[k] = 1e-5 * beta[k]
        difference = (motion_of(segments, beta + step, *np.split(x, 2, axis=1))
                      - motion_of(segments, beta - step, *np.split(x, 2, axis=1))) / (2.0 * step[k])
        assert_allclose(linear.motion[:, :, k], difference, atol=2e-5 * np.abs(difference).max())
    moved = x.copy()
    moved[segments.first, 1] += 1e-4
    there = motion_of(segments, beta, *np.split(moved, 2, axis=1))
    slope = linear.motion[:, :, 10]
    assert_allclose(slope, (there - x) / 1e-4, atol=2e-3 * np.abs(slope).max())
    step = np.zeros(linear.products.shape[-1])
    step[10], step[-1] = 1e-4, 1.0
    predicted = np.einsum("i,scij,j->sc", step, linear.products, step)
    assert_allclose(segments.squares(there[:, :2], there[:, 2:]), predicted, rtol=1e-3)


def test_a_simulation_over_segments_is_that_of_each_alone() -> None:
    leg = Leg()
    data = record(leg, default_rng(2), seconds=3.0)
    mechanism = leg2(lever_arm=leg.lever)
    signals = split_signals([data], mechanism, FitOptions(sensors="encoder"))
    segments = Segments(signals, mechanism, "linear", 1.0)
    q = np.stack([data["q1_rad"], data["q2_rad"]], axis=1)
    v = np.gradient(q, 0.01, axis=0)
    x = motion_of(segments, leg.beta(), q, v)
    for a, b in zip(segments.edges, segments.edges[1:]):
        alone, rate, _ = simulate(mechanism, leg.beta(), q[a], v[a], signals[0].torque[a:b], 0.01)
        assert_allclose(x[a:b], np.concatenate([alone, rate], axis=1), atol=1e-5)


@mark.parametrize("sensors", ["imu", "encoder"])
def test_a_healthy_leg_is_found_with_either_sensor_and_both_estimators_agree(sensors: str) -> None:
    rng = default_rng(1)
    leg = random_leg(rng)
    runs, mechanism = [record(leg, rng, seconds=10.0, name=str(k)) for k in range(2)], leg2(lever_arm=leg.lever)
    options = FitOptions(sensors=sensors, hold="auto", smoothing_velocity="auto")
    opinion = with_second_opinion(runs, mechanism, options, fit_admissible(runs, mechanism, options)).second_opinion
    assert opinion.method == "shooting" and opinion.held_out is None
    assert opinion.largest < MOST_DISAGREEMENT
    assert_allclose(opinion.beta[:5], leg.beta()[:5], rtol=0.02)


@mark.parametrize("level", [3e-4, 5e-4, 1e-3, 2e-3])
def test_a_geared_pendulum_is_found_whatever_noise_its_encoder_is_said_to_have(level: float) -> None:
    truth = GearedPendulum()
    run = record_geared(truth, default_rng(0))
    options = replace(ENCODER, hold="auto", smoothing_velocity="auto", noise={"encoder_rad": level})
    mle = fit_admissible([run], joint1(), options)
    found = with_second_opinion([run], joint1(), options, mle)
    if level < 1e-3:  # the inertia of mle is down to 84 and 3 % of the truth
        assert mle.beta[0] < 0.9 * truth.inertia and found.second_opinion.largest > MOST_DISAGREEMENT
        held_out = found.second_opinion.held_out
        assert found.method == "shooting" and held_out.ci95[0] > 0.0
        assert found.second_opinion.method == "mle"
        assert_array_equal(found.second_opinion.beta, mle.beta)
        assert not found.inadmissible and found.trajectories
    else:
        assert found.method == "mle" and "disturbance1_nm" in found.noise
        assert found.second_opinion is None or found.second_opinion.largest < MOST_DISAGREEMENT
    assert_allclose(found.beta[:2], truth.beta()[:2], rtol=0.04)
    assert_allclose(found.beta[2:], truth.beta()[2:], rtol=0.15)


@fixture(scope="module")
def short() -> tuple[list[Dataset], Mechanism, FitOptions, FitResult]:
    """Nine seconds of a geared pendulum, of which shooting and mle say different things."""
    run = record_geared(GearedPendulum(), default_rng(1), seconds=9.0)
    options = replace(ENCODER, noise={"encoder_rad": 3e-4})
    return [run], joint1(), options, fit_admissible([run], joint1(), options)


@mark.parametrize("low, method", [(0.005, "mle"), (0.02, "shooting")])
def test_shooting_is_reported_only_where_it_predicts_better_by_a_margin(low: float, method: str, short: Any,
                                                                        monkeypatch: MonkeyPatch) -> None:
    monkeypatch.setattr(second_opinion, "_held_out", lambda *_: HeldOut(low + 0.005, (low, low + 0.01), 99))
    assert with_second_opinion(*short).method == method


def test_a_run_that_is_too_short_leaves_mle_as_it_is(short: Any) -> None:
    found = with_second_opinion(*short)
    assert found.second_opinion.largest > MOST_DISAGREEMENT
    assert found.method == "mle" and found.second_opinion.held_out is None
    assert_array_equal(found.beta, short[3].beta)


def test_what_is_given_stays_as_it_is_on_a_leg_that_nothing_drives() -> None:
    rng = default_rng(3)
    leg = replace(Leg(), coulomb=(0.0, 0.0))
    run, mechanism = swing(leg, rng, (1.0, -0.6), seconds=15.0), leg2()
    options = FitOptions(sensors="encoder", encoders=(0, 1), fixed={"beta5": leg.beta()[4], "beta8": 0.0, "beta9": 0.0})
    found = with_second_opinion([run], mechanism, options, fit_admissible([run], mechanism, options)).second_opinion
    assert_allclose(found.beta[:5], leg.beta()[:5], rtol=0.01)
    assert np.isnan(found.disagreement[[4, 7, 8]]).all() and found.beta[7] == 0.0


def test_a_motion_that_does_not_tell_friction_from_an_offset_has_no_second_opinion_or_none_of_these() -> None:
    run = axis_run(0.02, 0.05)
    q, torque = run["q1_rad"] + 40.0 * run.time_s, run["tau1_nm"] + 40.0 * 0.05 + 0.1  # never stands still
    forward = replace(run, columns={"q1_rad": q, "tau1_nm": torque})
    mechanism = joint1(gravity_mps2=0.0, torque_offset=(0,))
    options = replace(ENCODER, hold="zero", noise={"encoder_rad": 1e-6})
    found = with_second_opinion([forward], mechanism, options, estimate([forward], mechanism, options, "mle"))
    assert found.second_opinion is None or np.isnan(found.second_opinion.disagreement[2:]).all()
