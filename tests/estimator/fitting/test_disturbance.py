"""A coloured disturbance torque: found where there is one, not where there is none, and declared."""

from dataclasses import replace

import numpy as np
from pytest import approx, fixture, mark

from daq import Dataset
from estimator import FitOptions, FitResult, fit
from estimator.fitting import (
    Disturbance,
    MarginalLikelihood,
    disturbance_likelihood,
    find_disturbance,
    free_mask,
    iterate,
    noise_floors,
    of_noise,
    start_state,
)
from estimator.fitting.disturbance import predicts_worse
from estimator.fitting.disturbance_cause import cause_of_disturbance
from estimator.fitting.extension import ExtendedFit
from estimator.free_runs import FittedModel
from estimator.likelihood import OFF, LatentProblem
from estimator.model import leg2
from estimator.signals import split_signals
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.ornstein_uhlenbeck import disturbed_record

OPTIONS = FitOptions(sensors="imu", hold="linear", smoothing_velocity="auto")
LEVEL, CONSTANT, WHITE = 0.02, 0.1, 0.02
Made = tuple[Leg, Dataset, FitResult]


@fixture(scope="module")
def wandering() -> Made:
    rng = np.random.default_rng(102)
    leg = random_leg(rng)
    data = disturbed_record(leg, rng, LEVEL, CONSTANT)
    return leg, data, fit([data], leg2(lever_arm=leg.lever), OPTIONS)


def test_level_and_time_constant_are_found(wandering: Made) -> None:
    leg, _, found = wandering
    assert "disturbance1_nm" not in found.noise
    assert found.noise["disturbance2_nm"] == approx(LEVEL, rel=0.3)
    assert found.noise["disturbance2_s"] == approx(CONSTANT, rel=0.5)
    assert found.noise["torque_nm"] == approx(WHITE, rel=0.1)
    assert np.mean(np.abs(found.beta - leg.beta()) < found.half_width) >= 8 / 9
    assert found.trajectories[0].disturbance is not None
    assert "coloured disturbance torque at joint 2" in " ".join(found.assumptions)


def test_white_noise_alone_is_too_sure(wandering: Made) -> None:
    """The same record told that there is no disturbance: narrower intervals, further off."""
    leg, data, found = wandering
    white = fit([data], leg2(lever_arm=leg.lever),
                replace(OPTIONS, noise={"disturbance1_nm": 0.0, "disturbance2_nm": 0.0}))
    assert np.all(white.own_std[:5] < 0.7 * found.own_std[:5])
    error, plain = (np.abs(f.beta - leg.beta())[:5] / f.own_std[:5] for f in (found, white))
    assert np.all(error < 2.0) and np.mean(plain) > np.mean(error)


def test_a_declared_disturbance_is_kept(wandering: Made) -> None:
    leg, data, _ = wandering
    given = {"disturbance1_nm": 0.0, "disturbance2_nm": 0.05, "disturbance2_s": 0.3}
    found = fit([data], leg2(lever_arm=leg.lever), replace(OPTIONS, noise=given))
    assert (found.noise["disturbance2_nm"], found.noise["disturbance2_s"]) == (0.05, 0.3)


def test_a_healthy_leg_has_none() -> None:
    rng = np.random.default_rng(7)
    leg = random_leg(rng)
    data = disturbed_record(leg, rng, 0.0, 1.0)
    found = fit([data], leg2(lever_arm=leg.lever), OPTIONS)
    assert not any(name.startswith("disturbance") for name in found.noise)
    assert found.trajectories[0].disturbance is None


def test_parameters_that_predict_worse_are_seen(wandering: Made) -> None:
    leg, data, _ = wandering
    mechanism = leg2(lever_arm=leg.lever)
    signals, truth = split_signals([data], mechanism, OPTIONS), leg.beta()
    wrong = truth * np.where(np.arange(9) < 5, 0.5, 1.0)
    right, near, off = (FittedModel(mechanism, "linear", beta) for beta in (truth, 1.001 * truth, wrong))
    assert predicts_worse(signals, OPTIONS, right, off)
    assert not predicts_worse(signals, OPTIONS, right, near)
    assert not predicts_worse(signals, OPTIONS, off, right)


def test_an_effect_of_a_fit_that_went_astray_explains_no_disturbance(wandering: Made) -> None:
    """There a disturbance is small, and next to no effect is left of it: but a second is predicted worse."""
    leg, data, _ = wandering
    mechanism = leg2(lever_arm=leg.lever)
    signals = split_signals([data], mechanism, OPTIONS)
    problem, large = LatentProblem(signals, mechanism, "linear"), np.array([0.0, 10.0])
    state = start_state(problem, signals, mechanism, OPTIONS, *free_mask(mechanism, OPTIONS))
    kept = FittedModel(mechanism, "linear", leg.beta())
    found = []
    for beta in (leg.beta(), leg.beta() * np.where(np.arange(9) < 5, 0.5, 1.0)):
        given, held = replace(state, beta=beta), np.zeros(9, dtype=bool)
        found.append(cause_of_disturbance(ExtendedFit(problem, given, signals, held, OPTIONS), (
            Disturbance(large, np.ones(2), state.noise.torque), kept)))
    assert found[0] is not None and found[1] is None


@fixture(scope="module")
def likelihood(wandering: Made) -> MarginalLikelihood:
    """At the plain fit of the record and of half of it as a second run; near rest friction is unknown."""
    leg, data, _ = wandering
    mechanism = leg2(lever_arm=leg.lever)
    half = Dataset("half", data.rate_hz, data.time_s[:900], {name: x[:900] for name, x in data.columns.items()})
    signals = split_signals([data, half], mechanism, OPTIONS)
    problem = LatentProblem(signals, mechanism, "linear")
    state = start_state(problem, signals, mechanism, OPTIONS, *free_mask(mechanism, OPTIONS))
    state = iterate(problem, state, np.ones(9, dtype=bool), OPTIONS, noise_floors(problem, mechanism, state.beta))
    assert state.noise.stiction.any()
    return disturbance_likelihood(signals, problem, state)


@mark.parametrize("joint", [0, 1])
@mark.parametrize("level, constant, white", [(0.02, 0.1, 0.02), (0.002, 0.4, 0.03), (0.05, 0.011, 0.004),
                                                          (0.5 * OFF * 0.02, 0.1, 0.02)])
def test_slopes_are_differences(likelihood: MarginalLikelihood, joint: int, level: float, constant: float,
                                white: float) -> None:
    centre = np.log([level, constant, white])
    other = Disturbance(np.array([0.01, 0.015]), np.array([0.05, 0.2]), np.array([0.003, 0.02]))

    def at(theta: np.ndarray) -> Disturbance:
        out = Disturbance(*(values.copy() for values in other))
        out.level[joint], out.time_constant[joint], out.white[joint] = np.exp(theta)
        return out

    value, slope = likelihood.climb(at(centre), joint)
    assert value == likelihood(at(centre))
    h = 4e-3  # a smaller step shows the digits that log p, 1e5, is rounded to
    for k, one in enumerate(h * np.eye(3)):
        near, far = (likelihood(at(centre + m * one)) - likelihood(at(centre - m * one)) for m in (1, 2))
        assert slope[k] == approx((8.0 * near - far) / (12.0 * h), rel=1e-6, abs=2e-3)


def test_a_search_ends_at_the_top(likelihood: MarginalLikelihood) -> None:
    """No level, time constant or white noise near what is found is likelier by what a search may leave."""
    begin = of_noise(likelihood.noise)
    found = find_disturbance(likelihood, begin, OPTIONS)
    assert found.level[0] == 0.0 and found.level[1] > 0.0
    top = likelihood(found)
    for values in ("level", "time_constant", "white"):
        for factor in (0.97, 1.03):
            changed = getattr(found, values) * np.array([1.0, factor])
            assert likelihood(found._replace(**{values: changed})) < top + 0.05


def test_a_likelihood_of_other_stiction_leaves_the_first_as_it_was(likelihood: MarginalLikelihood) -> None:
    found = Disturbance(np.array([0.0, 0.02]), np.array([0.1, 0.1]), np.array([0.003, 0.02]))
    known = likelihood.problem.stiction(likelihood.noise)
    assert known is not None
    before = likelihood(found)
    assert likelihood.with_stiction(4.0 * known)(found) != before
    assert likelihood.with_stiction(known)(found) == likelihood(found) == before
