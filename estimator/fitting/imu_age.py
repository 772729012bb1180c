"""`rough_age`: how late an IMU is against encoders and torque, before any fit.

Least squares of the filtered motion need no start and have one minimum. A late IMU leaves a residual at every joint, a
free pivot's above all: it is least where the IMU's readings are moved by their age. (Measured on legs of seven signal
chains: within 0.15 ms, where a fit of the unmoved readings ends at ages of 0.4 to 2.8 ms for 1.6 and 8.1.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from daq import FloatArray
from estimator.errors import FitError
from estimator.fitting.initial_guess import start_motions
from estimator.fitting.wls import stack_regressors, weighted_least_squares
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals import LEAST_SEGMENT, SignalSet, cut, is_plain, with_earlier_imu

STEP_S = 0.002
"""Of the search [s]: shorter than the width of its minimum, which is that of the motion."""
EARLIEST_S, LATEST_S = -0.01, 0.03
"""Ages that are looked at [s]; a sensor that is later is no sensor of this motion."""
NEAR, SHARP = 2, 0.6
"""Steps from the minimum at which the cost must be higher by so much [log N m]: else something other than time makes
the residual. (Measured: 0.9 to 2.8 higher with late IMUs and punctual ones, 0.3 where fast motion errs otherwise.)"""
EXCERPT = 4000
"""Most samples that are looked at, of each segment its first part."""


def rough_age(signals: Sequence[SignalSet], mechanism: Mechanism, options: FitOptions, free: NDArray[np.bool_],
              beta: FloatArray) -> float:
    """Age of the IMU [s], negative where it is early; 0 without an IMU, and where no age has a sharply least residual.
    """
    if options.sensors != "imu" or not is_plain(mechanism, options) or not mechanism.actuated:
        return 0.0
    share = min(1.0, EXCERPT / sum(len(s.time_s) for s in signals))
    parts = [cut(s, slice(0, max(LEAST_SEGMENT, round(share * len(s.time_s))))) for s in signals]

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
    except (FitError, np.linalg.LinAlgError):
        return 0.0
    k = int(np.argmin(costs))
    if not NEAR <= k < len(ages) - NEAR or min(costs[k - NEAR], costs[k + NEAR]) < costs[k] + SHARP:
        return 0.0
    before, here, after = costs[k - 1 : k + 2]
    return float(ages[k] + 0.5 * STEP_S * (before - after) / (before - 2.0 * here + after))
