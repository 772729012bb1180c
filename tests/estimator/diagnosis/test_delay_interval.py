"""Intervals of a torque's delay hold what is not known of the torque between samples."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.random import default_rng
from pytest import approx, mark

from estimator import FitOptions, diagnose
from estimator.diagnosis.account import interval
from estimator.effects import SensorTimeSkew, TorqueDelay
from estimator.likelihood import LatentProblem, Latents
from estimator.likelihood.effect_columns import slopes
from estimator.model import leg2
from estimator.signals import split_signals, torque_of
from tests.support.mujoco_leg import random_leg
from tests.support.timed_leg import Timing, record


@mark.parametrize(("delays_s", "low", "high"), [
    ((), -0.0102, -0.0098), ((0.0110,), -0.0112, -0.0098), ((0.0095, 0.0110), -0.0112, -0.0093),
    ((0.0126,), -0.0102, -0.0098)])  # more than half a sample of 5 ms away: another motion, not another hold
def test_an_interval_holds_those_of_other_holds(delays_s: tuple[float, ...], low: float, high: float) -> None:
    model: Any = SimpleNamespace(split=SimpleNamespace(delays_s=delays_s), problem=SimpleNamespace(dt=0.005))
    assert interval(model, TorqueDelay(), -0.010, 0.0002) == approx((low, high))
    assert interval(model, SensorTimeSkew(), -0.010, 0.0002) == approx((-0.0102, -0.0098))


def test_the_slope_of_a_delay_has_no_step_of_whole_samples() -> None:
    """Steps of a controller move by whole samples: across one, the delay of a fit seemed known to 0.01 ms."""
    leg = random_leg(default_rng(7))
    run = record(leg, default_rng(8), Timing(100.0, 1, 0.0, "zero", "pd"), seconds=6.0, name="run")
    mechanism = leg2(lever_arm=leg.lever)
    problem = LatentProblem(split_signals([run], mechanism, FitOptions()), mechanism, "zero", effects=(TorqueDelay(),))
    still = np.zeros_like(problem.torque)
    view = replace(problem.view(Latents(still, still, problem.torque), np.append(leg.beta(), 0.0)),
                   measured=problem.record)
    (inside,), (across,) = (slopes(TorqueDelay(), view, np.array([late_s])) for late_s in (-0.025, -0.02003))
    one, other = (np.abs(slope.readings[torque_of(1)]) for slope in (inside, across))
    assert other.max() == approx(one.max(), rel=0.5)
    fast = problem.record.readings[torque_of(1)] - problem.record.slow[torque_of(1)]
    assert np.abs(np.diff(fast)).max() / 2e-4 > 3.0 * one.max()  # a step in 0.2 ms


def test_the_interval_of_a_delay_under_a_loop_holds_it() -> None:
    """Steps of a loop at 100 Hz that act one and a half samples late: whole samples move exactly, parts do not."""
    timing = Timing(100.0, 1, 0.0156, "zero", "pd")
    rng = default_rng([6000, 5, 2])
    leg = random_leg(rng)
    runs = [record(leg, rng, timing, name=f"run{k}") for k in range(4)]
    found = diagnose(runs, leg2(lever_arm=leg.lever), FitOptions(hold="auto"), workers=1)
    (size,) = (s for c in found.causes if c.effect == "torque_delay" for s in c.size)
    assert found.hold == "zero" and size.ci95[0] <= -0.0156 <= size.ci95[1]
