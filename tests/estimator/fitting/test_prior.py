"""Known body values and parameters in a fit: by hand, against an exact combination, and on a leg that swings little."""

from dataclasses import replace

import numpy as np
from pytest import approx, raises

from estimator import FitError, FitOptions, fit
from estimator.fitting import next_measurement
from estimator.fitting.prior import prior_at, prior_values
from estimator.model import biped3, body_values, chain, formula, leg2, rigid_parameters
from tests.support.mujoco_leg import Leg, record

LEG = Leg()
BODIES = {"m1": LEG.m1, "lc1": LEG.c1, "I1": LEG.i1, "l1": LEG.l1, "m2": LEG.m2, "lc2": LEG.c2, "I2": LEG.i2}
MECHANISM = leg2(lever_arm=LEG.lever)
SMALL = record(LEG, np.random.default_rng(3), seconds=10.0, amplitude=0.3, high=2.0)


def test_rigid_parameters_are_those_of_the_contract_and_slopes_are_their_derivatives() -> None:
    value, slope = rigid_parameters(MECHANISM, BODIES)
    assert value == approx(LEG.beta()[:5], rel=1e-12)
    for j, name in enumerate(BODIES):
        more, _ = rigid_parameters(MECHANISM, {**BODIES, name: BODIES[name] + 1e-6})
        assert slope[:, j] == approx((more - value) / 1e-6, abs=1e-5)


def test_formulas_say_what_meanings_say() -> None:
    assert [formula(MECHANISM, k) for k in range(5)] == [p.meaning for p in MECHANISM.parameters[:5]]
    assert chain(3).parameters[0].meaning == "p11 = I1 + m1*lc1^2 + (m2 + m3)*l1^2"
    assert formula(biped3(), 5) == "g*(m1*lc1 + (m2 + m3)*l1)"
    assert "l3" not in body_values(chain(3))


def test_a_length_ties_two_parameters_and_nothing_else() -> None:
    """l1 alone says beta3 = l1 beta5: of every other direction the prior knows next to nothing."""
    std = 0.002
    prior = prior_at(MECHANISM, {"l1": (LEG.l1, std)}, LEG.beta())
    along = np.zeros(9)
    along[2], along[4] = 1.0, -LEG.l1
    expected = np.outer(along, along) / (std * LEG.beta()[4]) ** 2
    assert prior.information == approx(expected, rel=0.05, abs=1e-3 * expected.max())
    assert np.abs(prior.gradient).max() < 1e-6 * np.sqrt(expected.max())


def test_the_gradient_is_that_of_the_sum_of_squares() -> None:
    known = {"l1": (0.31, 0.01), "m2": (0.85, 0.05), "lc2": (0.14, 0.01), "beta4": (0.4, 0.02)}
    beta = 1.03 * LEG.beta()
    prior = prior_at(MECHANISM, known, beta)
    for k in range(5):
        step = np.eye(9)[k] * 1e-5
        slope = (prior_at(MECHANISM, known, beta + step).objective - prior_at(MECHANISM, known, beta - step).objective)
        assert prior.gradient[k] == approx(slope / 4e-5, rel=0.05, abs=0.5)


def test_a_known_parameter_is_combined_as_two_measurements() -> None:
    """On one short run, in which nothing votes, the mean is weighted by both informations."""
    options = FitOptions(sensors="imu", noise={"gyro_radps": 0.005, "accel_mps2": 0.05, "torque_nm": 0.02,
                                               "passive_nm": 0.002, "encoder_rad": 2.2e-4})
    short = SMALL.part(slice(0, 300))
    alone = fit([short], MECHANISM, options)
    std = float(alone.std[4])
    value = float(alone.beta[4]) + std
    both = fit([short], MECHANISM, replace(options, prior={"beta5": (value, std)}))
    assert not alone.agreement.disagree
    assert both.beta[4] == approx(alone.beta[4] + 0.5 * std, abs=0.1 * std)
    assert both.std[4] == approx(std / np.sqrt(2.0), rel=0.1)
    assert [one.name for one in both.prior] == ["beta5"]


def test_what_runs_say_of_a_known_value_is_told_apart_from_the_prior() -> None:
    covariance = np.diag((0.002 * LEG.beta()) ** 2)
    (length,) = prior_values(MECHANISM, {"l1": (LEG.l1 + 0.05, 0.005)}, LEG.beta(), covariance)
    assert length.fitted == approx(LEG.l1, abs=0.003) and length.contradiction > 5.0
    (mass,) = prior_values(MECHANISM, {"m1": (2.0, 0.1)}, LEG.beta(), covariance)
    assert (mass.fitted, mass.fitted_std, mass.contradiction) == approx((2.0, 0.1, 0.0), abs=1e-3)


def test_a_value_that_is_far_off_is_told_though_the_fit_follows_it() -> None:
    """Kilograms for grams: 100 standard deviations. The noise grows, and no single value seems wrong beside it."""
    options = FitOptions(sensors="imu")
    true = LEG.beta()[4]
    right, wrong = (fit([SMALL], MECHANISM, replace(options, prior={"beta5": (value, 0.02 * true)}))
                    for value in (1.01 * true, 3.0 * true))
    assert right.prior_conflict < 2.0 and wrong.prior_conflict > 3.0


def test_names_and_methods_that_know_no_prior_are_refused() -> None:
    with raises(FitError, match=r"\[prior\] m3 is no parameter of leg2"):
        fit([SMALL], MECHANISM, FitOptions(prior={"m3": (1.0, 0.1)}))
    with raises(FitError, match="--method wls uses no prior"):
        fit([SMALL], MECHANISM, FitOptions(prior={"l1": (0.3, 0.1)}), "wls")
    with raises(ValueError, match="no standard deviation above zero"):
        FitOptions(prior={"l1": (0.3, 0.0)})


def test_the_value_named_next_shrinks_the_intervals_as_promised() -> None:
    result = fit([SMALL], MECHANISM, FitOptions(sensors="imu"))
    found = next_measurement(result)
    assert found.share < 0.9
    true = dict(zip(MECHANISM.names, LEG.beta())) | BODIES
    known = fit([SMALL], MECHANISM, FitOptions(sensors="imu", prior={found.name: (true[found.name], found.std)}))
    for name, share in found.widths.items():
        k = MECHANISM.column(name)
        assert known.own_std[k] / result.own_std[k] == approx(share, abs=0.15)
