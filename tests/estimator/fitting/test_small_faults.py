"""Fits take small faults of sensors off the readings where the runs show them, and say so."""

from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest

from estimator import FitOptions, FitResult, fit
from estimator.model import leg2
from tests.support.lab_readings import SMALL, read_with
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.timed_leg import Timing, record

SAID = "small faults of sensors"


@cache
def leg() -> Leg:
    return random_leg(np.random.default_rng(3))


def fitted(faults: Mapping[str, float], tolerances: Mapping[str, tuple[float, ...]] | None, spring: float = 0.0
           ) -> FitResult:
    rng = np.random.default_rng(4)
    runs = [read_with(record(leg(), rng, Timing(100.0), seconds=8.0, spring=spring, name=f"r{k}"), faults)
            for k in range(3)]
    return fit(runs, leg2(lever_arm=leg().lever), FitOptions(hold="zero", tolerances=tolerances))


def test_parameters_of_a_leg_with_a_lab_s_sensors_are_nearer_to_the_truth() -> None:
    true = leg().beta()[:5]
    plain, corrected = fitted(SMALL, None), fitted(SMALL, {})
    errors = [np.abs(result.beta[:5] / true - 1.0) for result in (plain, corrected)]
    assert errors[1].max() < 0.01 and errors[1].max() < 0.5 * errors[0].max()
    (text,) = [text for text in corrected.assumptions if text.startswith(SAID)]
    assert "gyro scale" in text and "imu misalignment" in text and "tolerance" in text
    assert corrected.noise["passive_joint_nm"] < 0.5 * plain.noise["passive_joint_nm"]
    assert not [text for text in plain.assumptions if text.startswith(SAID)]
    low, high = corrected.ci95().T if isinstance(corrected.ci95(), np.ndarray) else zip(*corrected.ci95())
    assert all(a <= b <= c for a, b, c in zip(low, leg().beta(), high, strict=False))


@pytest.mark.parametrize("faults, spring", [({}, 0.0), ({}, 0.6), ({"gyro_scale": 0.06}, 0.0)])
def test_right_sensors_a_law_and_a_large_fault_are_left_as_they_are(faults: dict[str, float], spring: float) -> None:
    result = fitted(faults, {}, spring)
    told = [text for text in result.assumptions if text.startswith(SAID)]
    assert not told or "gyro scale" not in told[0]
    assert not told or faults  # what is right, or a law, gives no reason
