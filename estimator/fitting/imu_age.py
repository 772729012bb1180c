"""Age of an IMU against encoders and torque: `rough_age` before any fit, `with_skew` as a term of one.

Least squares of the filtered motion need no start and have one minimum. A late IMU leaves a residual at every joint, a
free pivot's above all: it is least where the IMU's readings are moved by their age. (Measured on legs of seven signal
chains: within 0.15 ms, where a fit of the unmoved readings ends at ages of 0.4 to 2.8 ms for 1.6 and 8.1.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import BoolArray, FloatArray
from estimator.effects import SensorTimeSkew
from estimator.fit_errors import FIT_ERRORS
from estimator.fitting.excerpt import excerpt
from estimator.fitting.extension import ExtendedFit, extend, without_sizes
from estimator.fitting.initial_guess import start_motions
from estimator.fitting.wls import stack_regressors, weighted_least_squares
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.result import TWO_SIDED
from estimator.signals import SignalSet, is_plain, with_earlier_imu

STEP_S = 0.002
"""Of the search [s]: shorter than the width of its minimum, which is that of the motion."""
EARLIEST_S, LATEST_S = -0.01, 0.03
"""Ages that are looked at [s]; a sensor that is later is no sensor of this motion."""
NEAR, SHARP = 2, 0.6
"""Steps from the minimum at which the cost must be higher by so much [log N m]: else something other than time makes
the residual. (Measured: 0.9 to 2.8 higher with late IMUs and punctual ones, 0.3 where fast motion errs otherwise.)"""
EXCERPT = 4000
"""Most samples that are looked at, of each segment its first part."""


def rough_age(signals: Sequence[SignalSet], mechanism: Mechanism, options: FitOptions, free: BoolArray,
              beta: FloatArray) -> float:
    """Age of the IMU [s], negative where it is early; 0 without an IMU, and where no age has a sharply least residual.
    """
    if options.sensors != "imu" or not is_plain(mechanism, options) or not mechanism.actuated:
        return 0.0
    parts = excerpt(signals, EXCERPT)[0]

    def cost(age_s: float) -> float:
        """Sum over joints of the log residual [log N m]."""
        moved = [with_earlier_imu(s, age_s) for s in parts]
        z, tau = stack_regressors(moved, start_motions(moved, mechanism, options), mechanism,
                                  options.cutoff(moved[0].rate_hz), options.filter_order)
        sigma = weighted_least_squares(z, tau, free, beta, 1.0)[2]
        return float(np.sum(np.log(np.maximum(sigma, 1e-300))))

    ages = np.arange(EARLIEST_S, LATEST_S + 0.5 * STEP_S, STEP_S)
    try:
        costs = np.array([cost(float(age)) for age in ages])
    except FIT_ERRORS:
        return 0.0
    k = int(np.argmin(costs))
    if not NEAR <= k < len(ages) - NEAR or min(costs[k - NEAR], costs[k + NEAR]) < costs[k] + SHARP:
        return 0.0
    before, here, after = costs[k - 1 : k + 2]
    return float(ages[k] + 0.5 * STEP_S * (before - after) / (before - 2.0 * here + after))


def with_skew(fitted: ExtendedFit) -> ExtendedFit:
    """The fit with the IMU's time line free against the controller's, and a sentence about it.

    Readings that were not moved by their age, and are not late by the choice of the hold either, are taken as they are
    where no clock has a bound.

    Clocks that were put together by messages agree to within a bound only; tens of microseconds cost the pivot's
    viscous friction several standard deviations. Where the data cannot place the IMU better than the bound does,
    the lines stay as they are, and there is no skew.
    """
    bound_s, age_s, chosen = fitted.bound_s, fitted.age_s, fitted.chosen
    aged = bound_s or age_s or (chosen is not None and chosen.imu_age_s)
    if not aged or not fitted.problem.has_imu or fitted.terms:
        return fitted
    _, again = extend(fitted, ((SensorTimeSkew(), np.zeros(1)),), np.ones(1, bool), fitted.state.noise)
    skew, std = float(again.beta[-1]), float(np.sqrt(again.covariance[-1, -1]))
    kept, told = _judged(again.converged, skew + age_s, std, bound_s)
    fitted = fitted._replace(said=(*fitted.said, told))
    return fitted if not kept else fitted._replace(state=without_sizes(fitted.state, again), terms=(
        (SensorTimeSkew(), np.array([skew])),))


def _judged(converged: bool, late_s: float, std_s: float, bound_s: float) -> tuple[bool, str]:
    """Whether the IMU is that late, and a sentence about it."""
    if bound_s == 0.0:
        if not (converged and abs(late_s) < LATEST_S):
            return False, "this motion does not determine how late the IMU is"
        return True, (f"the IMU is {1e3 * abs(late_s):.3g} ms {'late' if late_s > 0.0 else 'early'} against encoder "
                      f"and torque, +-{TWO_SIDED * std_s * 1e3:.2g} ms, by this motion; corrected")
    if not converged or std_s > bound_s:
        return False, (f"the IMU's time line is used as it is known (within {bound_s * 1e6:.0f} us); the motion does "
                       "not determine it better")
    if abs(late_s) > bound_s:
        return False, (f"the IMU would fit best {_late(late_s)} against the controller, more than the "
                       f"{bound_s * 1e6:.0f} us that clocks and [imu] leave open. This is not corrected, because "
                       "something else is wrong: run legid diagnose")
    return True, (f"the IMU is {_late(late_s)} against the controller, +-{TWO_SIDED * std_s * 1e6:.0f} us, by this "
                  f"motion (known: within {bound_s * 1e6:.0f} us); corrected")


def _late(skew_s: float) -> str:
    """In words, with the sign as a direction."""
    return f"{abs(skew_s) * 1e6:.0f} us {'late' if skew_s >= 0.0 else 'early'}"
