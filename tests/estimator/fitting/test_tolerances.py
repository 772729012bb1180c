"""The budget of a fit: intervals that hold what may be wrong with a rig, and parts that add up to them."""

from dataclasses import replace

import numpy as np
from pytest import approx, mark

from daq import Dataset
from estimator import FitOptions, FitResult, fit
from estimator.model import leg2
from tests.support.hidden_loops import record_loop
from tests.support.mujoco_leg import Leg, recorded, scaled

DEFAULTS = FitOptions(tolerances={})


def fitted(leg: Leg, runs: list[Dataset], options: FitOptions) -> FitResult:
    return fit(runs, leg2(lever_arm=leg.lever), options)


def held(result: FitResult, leg: Leg) -> int:
    low, high = result.ci95().T
    return int(np.sum((low <= leg.beta()) & (leg.beta() <= high)))


@mark.parametrize("count", [1, 3])
def test_parts_add_up_and_the_largest_is_the_torque_constant(count: int) -> None:
    leg, runs = recorded(11, count)
    result = fitted(leg, runs, DEFAULTS)
    budget = result.budget
    assert np.sum([part.covariance for part in budget.parts], axis=0) == approx(result.covariance, rel=1e-6)
    gain = budget.part("torque_gain")
    assert gain.tolerance == (0.05,)
    assert gain.std == approx(0.05 * np.abs(result.beta - budget.moved), rel=1e-6)
    assert all((gain.std[:5] > part.std[:5]).all() for part in budget.parts if part is not gain)


def test_without_tolerances_a_fit_is_what_it_was() -> None:
    leg, runs = recorded(12, 2)
    plain, none = fitted(leg, runs, FitOptions()), fitted(leg, runs, FitOptions(tolerances={"none": ()}))
    assert plain.budget is None
    assert none.beta == approx(plain.beta, rel=1e-9)
    assert none.half_width == approx(plain.half_width, rel=1e-9)


def test_a_wrong_torque_constant_within_its_tolerance_stays_within_the_intervals() -> None:
    leg, runs = recorded(13, 1)
    wrong = scaled(runs, "tau2_nm", 1.06)
    assert held(fitted(leg, wrong, FitOptions()), leg) < 5
    assert held(fitted(leg, wrong, DEFAULTS), leg) == 9


def test_a_parameter_that_is_known_tells_the_torque_constant() -> None:
    """With one inertia weighed beforehand a wrong scale is no longer hidden, and costs the others little."""
    leg, runs = recorded(14, 1)
    known = {"beta5": float(leg.beta()[4])}
    free = fitted(leg, runs, DEFAULTS).budget
    told = fitted(leg, runs, replace(DEFAULTS, fixed=known)).budget
    before, after = free.part("torque_gain"), told.part("torque_gain")
    assert after.std[0] < 0.3 * before.std[0]


def test_a_gyro_within_its_tolerance_is_learnt_where_the_runs_show_it() -> None:
    leg, runs = recorded(15, 3)
    wrong = scaled(runs, "gyro_radps", 1.01)
    tolerances = {"torque_gain": (0.0,)}
    plain, moved = fitted(leg, wrong, FitOptions()), fitted(leg, wrong, FitOptions(tolerances=tolerances))
    far = [float(np.abs(one.beta / leg.beta() - 1.0)[:5].max()) for one in (plain, moved)]
    assert held(plain, leg) < 7 and held(moved, leg) >= 8 and far[1] < far[0]


def test_stated_tolerances_go_before_the_defaults() -> None:
    leg, runs = recorded(16, 1)
    small = fitted(leg, runs, FitOptions(tolerances={"torque_gain": (0.001,), "none": ()}))
    assert [part.source for part in small.budget.parts if part.source not in ("noise", "scatter")] == ["torque_gain"]
    one = fitted(leg, runs, FitOptions(tolerances={"joint_stiffness@2": (0.2,), "none": ()})).budget
    assert one.part("joint_stiffness@2") is not None and one.part("joint_stiffness@1") is None


def test_a_delay_of_commands_is_as_uncertain_as_tolerances_make_it() -> None:
    """By noise alone it was known to 0.03 ms, where nobody had said that the encoder is in time to that."""
    runs, leg = record_loop("command_delay"), replace(leg2(), followers=(1,))
    options = FitOptions(sensors="encoder", unknown_loop=("delay_s",))
    (plain,), (none,), (wide,) = (fit(runs, leg, replace(options, tolerances=stated)).loop
                                  for stated in (None, {"none": ()}, {}))
    assert (none.value, none.std) == approx((plain.value, plain.std), rel=1e-9)
    assert wide.std > 2.0 * plain.std and abs(wide.value - plain.value) < wide.std
    assert abs(wide.value - 0.015) < wide.half
