"""Effects that a fit lacks: found where they would move its parameters, not found on legs that have none."""

from pytest import approx, mark

from daq import Dataset
from estimator import FitOptions, FitResult, fit
from estimator.model import leg2
from tests.support.mujoco_leg import Leg, recorded, scaled

OPTIONS = FitOptions(seeks_omitted=True)


def fitted(leg: Leg, runs: list[Dataset], options: FitOptions = OPTIONS) -> FitResult:
    return fit(runs, leg2(lever_arm=leg.lever), options)


@mark.parametrize("count, seconds", [(1, 20.0), (4, 20.0), (1, 3.5)])
@mark.parametrize("seed", [70, 71, 72])
def test_a_leg_without_a_fault_lacks_nothing(seed: int, count: int, seconds: float) -> None:
    leg, runs = recorded(seed, count, seconds)
    result = fitted(leg, runs)
    assert result.converged and result.omitted == ()


@mark.parametrize("count, error", [(1, 0.02), (4, 0.02), (1, -0.02)])
def test_a_wrong_gyro_scale_is_found_and_so_is_what_it_does(count: int, error: float) -> None:
    """The true parameters lie outside their intervals, about as far as is said."""
    leg, runs = recorded(73, count, 20.0)
    result = fitted(leg, scaled(runs, "gyro_radps", 1.0 + error))
    found = {one.effect: one for one in result.omitted}
    assert result.omitted[0].p_value < 1e-6 and "gyro_scale" in found
    scale = found["gyro_scale"]
    k = result.mechanism.column(scale.parameter)
    missed = abs(result.beta[k] - leg.beta()[k]) / result.half_width[k]
    assert missed > 1.0 and scale.half_widths == approx(missed, rel=0.4)


def test_a_fit_that_is_not_asked_does_not_look() -> None:
    leg, runs = recorded(73, 1, 20.0)
    assert fitted(leg, scaled(runs, "gyro_radps", 1.02), FitOptions()).omitted == ()


def test_a_fit_of_parameters_that_are_all_given_lacks_nothing_and_keeps_them() -> None:
    leg, runs = recorded(73, 1, 20.0)
    given = dict(zip(leg2().names, map(float, leg.beta()), strict=True))
    result = fitted(leg, scaled(runs, "gyro_radps", 1.02), FitOptions(fixed=given, seeks_omitted=True, tolerances={}))
    assert result.omitted == () and list(result.beta) == list(given.values())
