"""The tolerances of a rig move a fit to what its runs show of small faults, and widen its intervals."""

from collections.abc import Mapping
from functools import cache

import numpy as np

from estimator import FitOptions, FitResult, fit
from estimator.model import leg2
from tests.support.lab_readings import SMALL, read_with
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.timed_leg import Timing, record


@cache
def leg() -> Leg:
    return random_leg(np.random.default_rng(3))


def fitted(faults: Mapping[str, float], tolerances: Mapping[str, tuple[float, ...]] | None
           ) -> FitResult:
    rng = np.random.default_rng(4)
    runs = [read_with(record(leg(), rng, Timing(100.0), seconds=8.0, name=f"r{k}"), faults)
            for k in range(3)]
    return fit(runs, leg2(lever_arm=leg().lever), FitOptions(hold="zero", tolerances=tolerances))


def test_parameters_of_a_leg_with_a_lab_s_sensors_are_nearer_to_the_truth() -> None:
    true = leg().beta()
    plain, tolerated = fitted(SMALL, None), fitted(SMALL, {})
    errors = [np.abs(result.beta[:5] / true[:5] - 1.0) for result in (plain, tolerated)]
    assert errors[1].max() < 0.01 and errors[1].max() < 0.5 * errors[0].max()
    held = [[low <= value <= high for (low, high), value in zip(result.ci95(), true, strict=True)]
            for result in (plain, tolerated)]
    assert all(held[1]) and not all(held[0])
