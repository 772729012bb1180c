"""Torque between samples that no sample shows: a controller's steps of which the log holds only some.

A log of 200 Hz shows two or three of five steps of a loop at 500 Hz. What the others do moves the leg, but neither the
torque's sensor nor an accelerometer at the samples reads it. Taken for noise of these sensors, it makes their levels
several times too large and biases the parameters (measured: by 2.5 %, with 4096 counts). So it is noise of the
equation of motion, at the Gauss points. That it correlates with the acceleration is left alone: `expected_score` would
take it off the parameters, but not off the effects' scores, which then suspect a rotor. (Measured on these legs: by at
most 0.4 % of a parameter.)

It is sought where the level of a sensor is below what neighbouring samples show of it, so that a part of their activity
is motion, and kept where the likelihood asks for it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.fit_errors import FIT_ERRORS
from estimator.fitting.extension import ExtendedFit
from estimator.fitting.gauss_newton import MAX_ITERATIONS, iterate
from estimator.fitting.initial_guess import noise_floors
from estimator.fitting.latent_motion import marginal_of
from estimator.likelihood import LatentProblem, Noise

MOVES = 0.85
"""Noise level over the activity of neighbouring samples, below which a part of that activity is motion. (Of white noise
alone it is 0.9 to 1.1 on legs under a plan, and 0.55 to 0.73 under a PD loop of several ticks a sample.) It saves time
alone: on eight legs of MuJoCo the likelihood keeps nothing where every fit is asked."""
FIRST_STEPS = 6
"""Steps by which a fit with such torque must be the likelier one. It saves time alone: where nothing asks for it, its
level falls for tens of steps. (Of 29 fits, and of 18 fresh ones, none that is kept was less likely by then.)"""


def with_unseen_torque(fitted: ExtendedFit) -> ExtendedFit:
    """The fit with torque that no sample shows at every driven joint; as it was where nothing asks for it."""
    problem, state, _, free, options, *_ = fitted
    mechanism = problem.mechanism
    joints = [j for j in mechanism.actuated if options.torque_noise(j, True) is None]
    floors = noise_floors(problem, mechanism, state.beta)
    if problem.by_law or not state.converged or not joints or not _moves(problem, state.noise, joints):
        return fitted
    unseen = np.zeros(problem.n)
    unseen[joints] = state.noise.torque[joints]
    begin = replace(state, noise=replace(state.noise, unseen=unseen))
    try:
        least = marginal_of(problem, state)
        for limit, more in ((FIRST_STEPS, 0.0), (MAX_ITERATIONS, 0.5 * len(joints) * np.log(problem.total))):
            found = iterate(problem, begin, free, options, floors, limit)
            if marginal_of(problem, found) <= least + more:
                return fitted
    except FIT_ERRORS:
        return fitted
    return fitted._replace(state=found) if found.converged else fitted


def _moves(problem: LatentProblem, noise: Noise, joints: list[int]) -> bool:
    """Whether the level of a driven torque, a gyro or an accelerometer is below what its neighbouring samples show."""
    shown = problem.shown
    pairs = ((noise.torque[joints], shown.torque[joints]), (noise.gyro, shown.gyro), (noise.accel, shown.accel))
    return any(np.any(level < MOVES * activity) for level, activity in pairs)
