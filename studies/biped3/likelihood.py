"""Likelihood of an estimate against that of the truth on its own record: the likelihood ratio of the study's mle.

Its distribution does not depend on how the model is parametrised: for an efficient estimator it is chi-squared with
as many degrees of freedom as there are parameters, also where the parameters' errors are so large that covariances
mean little. A negative one would show that the search ended in a false minimum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import Dataset, FloatArray
from estimator import FitOptions
from estimator.fitting import known_noise
from estimator.likelihood import BatchProblem, Records
from estimator.signals import split_signals
from studies.walker import Step, motor_mechanism

STEPS = 12
CONVERGED = 1e-6
"""A step of the latents that would lower the sum of squares by less than this ends the search for the best motion."""


def likelihood_ratio(records: Sequence[Dataset], options: FitOptions, beta: FloatArray, truth: FloatArray,
                     step: Step) -> FloatArray:
    """(R,) 2 (log L(beta) - log L(truth)) of each record at its own beta (R, p).

    NaN where beta is, or where no best motion was found.
    """
    mechanism = motor_mechanism()
    problem = BatchProblem(mechanism, records[0].rate_hz, options.hold, known_noise(mechanism, options))
    signals = [split_signals([record], mechanism, options)[0] for record in records]
    data = Records(np.stack([s.angles for s in signals]), np.stack([s.torque for s in signals]))
    out = np.full(len(records), np.nan)
    good = np.flatnonzero(np.isfinite(beta).all(axis=1))
    if good.size:
        part = data.pick(good)
        out[good] = (smallest_misfit(problem, part, np.tile(truth, (good.size, 1)), step)
                     - smallest_misfit(problem, part, beta[good], step))
    return out


def smallest_misfit(problem: BatchProblem, records: Records, beta: FloatArray, step: Step) -> FloatArray:
    """(R,) sum of squares of each record at beta (R, p) with the motion at its best, sought from the true one."""
    x = np.tile(np.concatenate([step.q, step.qd, step.torque], axis=-1), (len(beta), 1, 1))
    for _ in range(STEPS):
        try:
            point = problem.linearise(records, x, beta)
        except np.linalg.LinAlgError:
            break
        if (point.decrease < CONVERGED).all():
            return point.objective
        x = x + point.step
    if len(beta) == 1:
        return np.array([np.nan])
    alone = [smallest_misfit(problem, records.pick(np.array([k])), beta[k : k + 1], step) for k in range(len(beta))]
    return np.concatenate(alone)
