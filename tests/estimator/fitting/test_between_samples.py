"""What happens between samples: reversals and rest of a leg with dry friction, and torque as a controller makes it."""

from dataclasses import replace

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, fixture, mark
from scipy.interpolate import CubicSpline

from daq import Dataset
from daq.runs import RawTable
from daq.timing import align_table
from estimator import FitOptions, fit
from estimator.fitting import fit_nominal
from estimator.fitting.extension import HoldChoice
from estimator.fitting.motion_search import first_fit, with_hold
from estimator.model import GAUSS, HOLDS, Collocation, Mechanism, lag, leg2
from estimator.model.collocation import spline_slopes
from tests.support.mujoco_leg import Leg, random_leg, record
from tests.support.stick_slip_leg import move, sample
from tests.support.timed_leg import Timing
from tests.support.timed_leg import record as record_timed


def rubbing(seed: int, knee_nm: float, rate_hz: float = 100.0, closed: bool = True) -> tuple[Leg, Dataset]:
    rng = default_rng(seed)
    leg = replace(random_leg(rng), coulomb=(0.03, knee_nm))
    return leg, sample(move(leg, rng, closed=closed), rng, rate_hz)


@fixture(scope="module")
def errors() -> np.ndarray:
    """(fits, 9) errors over standard deviations of legs under position control at 1 kHz, logged at 100 Hz."""
    found = []
    for seed in range(6):
        leg, run = rubbing(seed, 0.2)
        result = fit([run], leg2(lever_arm=leg.lever), FitOptions(hold="auto"))
        assert result.converged
        found.append((result.beta - leg.beta()) / result.std)
    return np.array(found)


def test_dry_friction_comes_out_within_its_interval(errors: np.ndarray) -> None:
    """Friction of a tenth of the peak torque; its level was 5 standard deviations low, viscous friction 4 high."""
    assert np.all(np.abs(errors[:, [6, 8]].mean(axis=0)) < 1.2)
    assert np.mean(np.abs(errors) < 1.96) > 0.8  # 0.62 before; all inertias of a leg err together


def test_inertias_are_not_low_by_the_torque_s_curve(errors: np.ndarray) -> None:
    """Straight lines between samples made all of them 1.5 standard deviations smaller."""
    assert np.all(np.abs(errors[:, :5].mean(axis=0)) < 0.9)


def test_a_held_torque_is_recognised() -> None:
    rng = default_rng(5)
    leg = random_leg(rng)
    run = record(leg, rng, seconds=8, hold="zero", high=8.0)
    found = fit([run], leg2(lever_arm=leg.lever), FitOptions(hold="auto"))
    assert found.hold == "zero" and found.hold_margin is not None and found.hold_margin > 100.0
    assert "'zero'" in found.assumptions[0]


def test_a_controller_s_torque_is_recognised_as_smooth() -> None:
    leg, run = rubbing(11, 0.04, 50.0)
    mechanism, options = leg2(lever_arm=leg.lever), FitOptions(hold="auto")
    found = fit([run], mechanism, options)
    assert found.hold == "smooth" and (found.hold_margin or 0.0) > 5.0
    hold, known, *_ = fit_nominal([run], mechanism, options)  # without the rest of a fit
    assert hold == found.hold and known == found.mechanism
    line = fit([run], leg2(lever_arm=leg.lever), FitOptions(hold="linear"))
    assert found.noise.get("unseen2_nm", 0.0) < line.noise["unseen2_nm"]  # a line between samples misses the curve


@mark.parametrize("sensors", ["imu", "encoder"])
def test_the_noise_of_the_measured_torque_decides_nothing(sensors: str) -> None:
    """Where the holds can hardly be told apart the straight line was ahead by 7 to 10 on every leg (encoder)."""
    for seed in (3000, 3001):
        leg, run = rubbing(seed, 0.04, 100.0, closed=False)
        found = fit([run], leg2(lever_arm=leg.lever), FitOptions(sensors=sensors, hold="auto"))
        assert found.hold == "smooth" and found.hold_margin is not None and found.hold_margin > -3.0


def test_a_torque_with_corners_at_the_samples_is_recognised() -> None:
    rng = default_rng(3000)
    leg = random_leg(rng)
    found = fit([record(leg, rng, high=8.0)], leg2(lever_arm=leg.lever), FitOptions(hold="auto"))
    assert found.hold == "linear" and (found.hold_margin or 0.0) > 20.0


def test_a_smooth_torque_s_integral_and_first_moment() -> None:
    """Of a sine of eight samples a period: a straight line is 5 and 1 % off, the curve less than 1 and 0.4 %."""
    dt, omega = 0.01, 2.0 * np.pi / 0.08
    t = np.arange(200) * dt
    u, fine = np.sin(omega * t)[:, None], (np.arange(400) + 0.5) / 400
    c = Collocation(leg2(), dt, "smooth")
    left = slice(50, 150)
    line = c.torque(np.hstack([u, u]), left)[0]
    curve = c.between(np.hstack([u, u]), np.array([200]))
    assert curve is not None
    true = np.sin(omega * (t[left, None] + dt * fine)).T
    for weights, power in (((0.5, 0.5), 0), ((0.5 * (GAUSS[0] - 0.5), 0.5 * (GAUSS[1] - 0.5)), 1)):
        wanted = np.mean(true * (fine[:, None] - 0.5) ** power, axis=0)
        straight, bent = (np.array(weights) @ x for x in (line, line + curve[0][:, left]))
        size = np.abs(wanted).max()
        assert np.abs(straight - wanted).max() > (0.004 if power else 0.04) * size
        assert np.abs(bent - wanted).max() < (0.004 if power else 0.01) * size


def test_slopes_are_those_of_scipy_s_spline() -> None:
    u = default_rng(1).normal(size=(400, 2)).cumsum(axis=0)
    wanted = CubicSpline(np.arange(400), u).derivative()(np.arange(400))
    assert_allclose(spline_slopes(u)[40:-40], wanted[40:-40], atol=1e-12)
    line = np.arange(3.0)[:, None] * [[2.0, -1.0]]
    assert_allclose(spline_slopes(line), [[2.0, -1.0]] * 3, atol=1e-12)


def timed(timing: Timing) -> tuple[Mechanism, list[Dataset]]:
    rng = default_rng(11)
    leg = random_leg(rng)
    return leg2(lever_arm=leg.lever), [record_timed(leg, rng, timing, seconds=8.0, name=f"r{k}") for k in range(4)]


@mark.parametrize("timing, hold", [
    (Timing(200), "zero"), (Timing(1000, 5), "zero/5"), (Timing(400, 2), "zero/2"),
    (Timing(200, between="average"), "past"),
    (Timing(200, delay_s=0.007, loop="pd"), "zero"), (Timing(100, delay_s=0.012), "zero"),
    (Timing(200, delay_s=0.007, between="ramp"), "smooth")])
def test_hold_and_delay_are_chosen_together(timing: Timing, hold: str) -> None:
    """Half a sample of a delay is the difference between two holds: alone, the hold took half a tick of a delay."""
    mechanism, runs = timed(timing)
    assert fit_nominal(runs, mechanism, FitOptions(hold="auto"))[0] == hold


@mark.parametrize("between, hold", [("average", "past/2"), ("zero", "zero/2"), ("ramp", "smooth")])
def test_the_hold_of_an_averaged_record_is_that_of_its_own_samples(between: str, hold: str) -> None:
    """Half a sample of the file is a quarter of one of the grid: a mean over the past was 2.5 ms of a delay."""
    mechanism, runs = timed(Timing(200, between=between))
    coarse = [align_table(RawTable(run.name, run.time_s, run.columns), 100.0) for run in runs]
    assert coarse[0].averaged == approx(2.0) and runs[0].averaged == 1.0
    assert fit_nominal(coarse, mechanism, FitOptions(hold="auto"))[:1] == (hold,)


@mark.parametrize("hold", HOLDS)
def test_every_hold_acts_as_late_as_it_says(hold: str) -> None:
    """In the mean over an interval, of a ramp."""
    u = np.arange(60.0)[:, None]
    c = Collocation(leg2(), 0.01, hold)
    torque = c.torque(np.hstack([u, u]), slice(30, 40))
    curve = c.between(np.hstack([u, u]), np.array([60]))
    mean = (torque if curve is None else torque + curve[:, :, 30:40])[0].mean(axis=0)
    assert_allclose(mean, np.arange(30, 40) + 0.5 - lag(hold), atol=1e-9)


@mark.parametrize("late", [0.2, 0.5, 1.0])
def test_a_held_torque_steps_within_an_interval(late: float) -> None:
    u = default_rng(3).normal(size=(20, 2))
    values = Collocation(leg2(), 0.01, "zero", late).torque(u, slice(0, 19))[0]
    fine = (np.arange(20000) + 0.5) / 20000
    acting = np.where(fine[:, None] < late, u[:-1, 0], u[1:, 0])
    assert_allclose(values.mean(axis=0), acting.mean(axis=0), atol=1e-3)
    moments = (GAUSS[0] - 0.5) * values[0] / 2 + (GAUSS[1] - 0.5) * values[1] / 2
    assert_allclose(moments, np.mean(acting * (fine[:, None] - 0.5), axis=0), atol=1e-3)


def test_a_short_record_of_a_late_torque_still_has_a_hold() -> None:
    """Its segments are shorter than the delays that are looked for."""
    rng = default_rng(4)
    leg = random_leg(rng)
    run = record_timed(leg, rng, Timing(500, delay_s=0.015), seconds=3.0)
    short = [replace(run.part(slice(k, k + 60)), name=f"r{k}") for k in range(300, 1400, 60)]
    hold, *_ = fit_nominal(short, leg2(lever_arm=leg.lever), FitOptions(hold="auto"))
    assert hold in HOLDS


def test_a_hold_is_not_compared_with_itself() -> None:
    """A held torque that is late may be likelier than the same hold in time, which is chosen for its simplicity."""
    assert "'zero'" not in str(HoldChoice("zero", -62.9, "zero"))
    assert "'smooth'" in str(HoldChoice("zero", 1.0, "smooth"))


def test_a_hold_that_is_stated_is_asked_no_more() -> None:
    rng = default_rng(5)
    leg = random_leg(rng)
    begun = first_fit([record(leg, rng, seconds=4)], leg2(lever_arm=leg.lever), FitOptions(hold="smooth"))
    assert with_hold(begun) is begun and begun.chosen is None


def test_a_late_torque_has_the_delays_of_both_holds_that_are_hardly_told_apart() -> None:
    late = HoldChoice("zero", 1.0, "smooth", 0.003, apart_s=0.001)
    assert late.delays_s == approx((0.003, 0.004))
    assert late._replace(apart_s=0.0).delays_s == (0.003,) and late._replace(delay_s=0.0).delays_s == ()
