"""How late an IMU is, found before a fit and in it; nothing of the plant is the estimator's."""

import numpy as np
from pytest import approx, mark

from estimator import FitOptions, fit
from estimator.fitting import free_mask
from estimator.fitting.imu_age import rough_age
from estimator.model import leg2
from estimator.signals import split_signals
from tests.support.mujoco_leg import random_leg
from tests.support.timed_leg import Timing, record

CUTOFF_HZ = 50.0
FILTER_S = 1.0 / (2.0 * np.pi * CUTOFF_HZ)


@mark.parametrize("timing, age_s", [
    (Timing(imu_age_s=0.005, imu_cutoff_hz=CUTOFF_HZ), 0.005 + FILTER_S),
    (Timing(1000, 5, loop="pd", imu_cutoff_hz=CUTOFF_HZ), FILTER_S),
    (Timing(), 0.0)])
def test_a_late_imu_is_seen_before_any_fit(timing: Timing, age_s: float) -> None:
    rng = np.random.default_rng(8)
    leg = random_leg(rng)
    run, mechanism, options = record(leg, rng, timing), leg2(lever_arm=leg.lever), FitOptions()
    found = rough_age(split_signals([run], mechanism, options), mechanism, options, *free_mask(mechanism, options))
    assert found == approx(age_s, abs=3e-4)


def test_a_fit_corrects_a_late_imu_and_says_so() -> None:
    rng = np.random.default_rng(9)
    leg = random_leg(rng)
    runs = [record(leg, rng, Timing(500, 2, loop="pd", imu_cutoff_hz=100.0), name=name) for name in "ab"]
    found = fit(runs, leg2(lever_arm=leg.lever), FitOptions(hold="auto"))
    (told,) = (text for text in found.assumptions if "IMU" in text)
    assert "late against encoder and torque" in told and "corrected" in told
    assert float(told.split()[3]) == approx(1.6, abs=0.25)
    assert found.beta[5] == approx(leg.beta()[5], rel=0.3)  # of an uncorrected age negative damping
