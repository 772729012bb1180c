"""A coloured disturbance torque: found where there is one, not where there is none, and declared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq import Dataset
from estimator import FitOptions, FitResult, fit
from estimator.fitting.disturbance import predicts_worse
from estimator.model import leg2
from estimator.signals import split_signals
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.ornstein_uhlenbeck import disturbed_record

OPTIONS = FitOptions(sensors="imu", hold="linear", smoothing_velocity="auto")
LEVEL, CONSTANT, WHITE = 0.02, 0.1, 0.02
Made = tuple[Leg, Dataset, FitResult]


@pytest.fixture(scope="module")
def wandering() -> Made:
    rng = np.random.default_rng(102)
    leg = random_leg(rng)
    data = disturbed_record(leg, rng, LEVEL, CONSTANT)
    return leg, data, fit([data], leg2(lever_arm=leg.lever), OPTIONS)


def test_level_and_time_constant_are_found(wandering: Made) -> None:
    leg, _, found = wandering
    assert "disturbance1_nm" not in found.noise
    assert found.noise["disturbance2_nm"] == pytest.approx(LEVEL, rel=0.3)
    assert found.noise["disturbance2_s"] == pytest.approx(CONSTANT, rel=0.5)
    assert found.noise["torque_nm"] == pytest.approx(WHITE, rel=0.1)
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
    assert predicts_worse(signals, mechanism, "linear", OPTIONS, (truth, wrong))
    assert not predicts_worse(signals, mechanism, "linear", OPTIONS, (truth, 1.001 * truth))
    assert not predicts_worse(signals, mechanism, "linear", OPTIONS, (wrong, truth))
