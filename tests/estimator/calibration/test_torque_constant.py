"""The torque constant from holds: the truth comes back, the interval holds, and what does not show it is refused."""

import numpy as np
from pytest import approx, mark, raises

from estimator import FitError
from estimator.calibration import Holds, Weight, fit_torque_constant

G = 9.81
WEIGHT = Weight(0.5, 0.25)


def holds(seed: int, scatter: float = 0.005, tilt: float = 0.0,
          count: int = 12, sides: tuple[int, ...] = (1, -1), reach: float = 0.9) -> Holds:
    """Torques that friction and the moments of link and weight make, as currents."""
    rng = np.random.default_rng(seed)
    angle = np.tile(np.linspace(-reach, reach, count), 2)
    p = np.repeat([0.0, 1.0], count)
    side = np.resize(sides, angle.size)
    angle[p == 1] *= 0.45
    torque = (0.105 + p * 0.5 * 0.25) * G * np.sin(angle) + 0.04 * (1 + 0.5 * p) * side
    torque += scatter * rng.standard_normal(angle.size)
    return Holds(torque / 0.9 + 0.03, angle + tilt, side.astype(float), p)


def test_constant_friction_and_own_moment_come_back() -> None:
    found = fit_torque_constant(holds(1, scatter=0.0), WEIGHT, G)
    assert found.value == approx(0.9, rel=1e-9)
    assert (found.friction_nm, found.own_moment_kgm) == approx((0.04, 0.105), rel=1e-9)


@mark.parametrize("tilt", [-0.1, 0.05])
def test_a_zero_of_the_angle_that_is_off_does_not_spoil_it(tilt: float) -> None:
    found = fit_torque_constant(holds(1, scatter=0.0, tilt=tilt), WEIGHT, G)
    assert found.value == approx(0.9, rel=1e-9) and found.tilt_rad == approx(-tilt, abs=1e-9)


def test_the_interval_holds_in_nineteen_of_twenty() -> None:
    found = [fit_torque_constant(holds(seed), WEIGHT, G) for seed in range(400)]
    assert 0.92 < np.mean([abs(f.value - 0.9) < f.half_holds for f in found]) < 0.98
    assert all(f.half > np.hypot(f.half_holds, 0.99 * f.half_friction) for f in found)


@mark.parametrize("share", [-0.15, 0.15])
def test_friction_that_grows_with_the_angle_stays_within_the_interval(share: float) -> None:
    made = holds(1, scatter=0.0)
    uneven = 0.04 * (1 + 0.5 * made.weighted) * share * made.side * np.abs(np.sin(made.angle_rad)) / np.sin(0.9)
    found = fit_torque_constant(made._replace(current=made.current + uneven / 0.9), WEIGHT, G)
    assert 1e-4 < abs(found.value - 0.9) < found.half


def test_the_weight_s_own_error_widens_it() -> None:
    exact = fit_torque_constant(holds(1), WEIGHT, G)
    rough = fit_torque_constant(holds(1), Weight(0.5, 0.25, 0.0, 0.005), G)
    assert rough.half == approx(np.hypot(exact.half, 0.02 * exact.value), rel=1e-6)


@mark.parametrize("made, line", [
    (holds(1, count=5), "5 usable holds with the weight, at least 6"),
    (holds(1, reach=0.1), "too much alike in angle; use more torque"),
    (holds(1, sides=(1,)), "approached from one side"),
    (holds(1)._replace(current=-holds(1).current), "acts in the wrong direction"),
    (holds(1)._replace(angle_rad=np.where(holds(1).weighted == 1, 1.3 + 0.3 * holds(1).angle_rad, holds(1).angle_rad)),
     "too much alike|do not part"),
])
def test_what_does_not_show_it_is_refused_with_a_remedy(made: Holds, line: str) -> None:
    with raises(FitError, match=line):
        fit_torque_constant(made, WEIGHT, G)
