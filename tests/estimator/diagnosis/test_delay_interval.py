"""Intervals of a torque's delay hold what is not known of the torque between samples."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimator import FitOptions
from estimator.diagnosis import diagnose
from estimator.diagnosis.account import interval
from estimator.effects import SensorTimeSkew, TorqueDelay
from estimator.model import leg2
from tests.support.mujoco_leg import random_leg
from tests.support.timed_leg import Timing, record


@pytest.mark.parametrize(("delays_s", "low", "high"), [
    ((), -0.0102, -0.0098), ((0.0110,), -0.0112, -0.0098), ((0.0095, 0.0110), -0.0112, -0.0093),
    ((0.0126,), -0.0102, -0.0098)])  # more than half a sample of 5 ms away: another motion, not another hold
def test_an_interval_holds_those_of_other_holds(delays_s: tuple[float, ...], low: float, high: float) -> None:
    model: Any = SimpleNamespace(split=SimpleNamespace(delays_s=delays_s), problem=SimpleNamespace(dt=0.005))
    assert interval(model, TorqueDelay(), -0.010, 0.0002) == pytest.approx((low, high))
    assert interval(model, SensorTimeSkew(), -0.010, 0.0002) == pytest.approx((-0.0102, -0.0098))


def test_the_interval_of_a_delay_under_a_loop_holds_it() -> None:
    """Steps of a loop at 100 Hz that act one and a half samples late: whole samples move exactly, parts do not."""
    timing = Timing(100.0, 1, 0.0156, "zero", "pd")
    rng = np.random.default_rng([6000, 5, 2])
    leg = random_leg(rng)
    runs = [record(leg, rng, timing, name=f"run{k}") for k in range(4)]
    found = diagnose(runs, leg2(lever_arm=leg.lever), FitOptions(hold="auto"), workers=1)
    (size,) = (s for c in found.causes if c.effect == "torque_delay" for s in c.size)
    assert found.hold == "zero" and size.ci95[0] <= -0.0156 <= size.ci95[1]
