"""The estimators mle, mle-free, wls, rls and hekf, their starts and their bounds.

Every constant has a text. One that gives neither a measurement nor a fact of legs, sensors or arithmetic is a
convention.
"""

from estimator.fitting.admissibility import faults, fit_admissible
from estimator.fitting.disturbance import (
    Disturbance,
    MarginalLikelihood,
    disturbance_likelihood,
    find_disturbance,
    of_noise,
)
from estimator.fitting.fit import fit, fit_nominal
from estimator.fitting.fit_each import fit_each
from estimator.fitting.gauss_newton import MAX_ITERATIONS, Policies, descend, iterate
from estimator.fitting.initial_guess import gentle_start, noise_floors, start_motion, start_state
from estimator.fitting.latent_motion import converge_motion
from estimator.fitting.loop_limit import limit_met
from estimator.fitting.loop_terms import UNLIMITED
from estimator.fitting.mle import describe_smoothing_velocity
from estimator.fitting.motion_search import find_loop
from estimator.fitting.next_measurement import CALIBRATED, Measurement, body_unit, next_measurement
from estimator.fitting.noise_levels import disturbance_levels, imu_levels, torque_levels
from estimator.fitting.noise_update import PASSIVE_SHARE, TORQUE_SHARE, mistaken_torques
from estimator.fitting.profile_likelihood import known_noise
from estimator.fitting.scale import has_torque, require_scale
from estimator.fitting.second_opinion import with_second_opinion
from estimator.fitting.tolerances import Tolerated, tolerated
from estimator.fitting.wls import design_rows, free_mask, weighted_least_squares

__all__ = [
    "CALIBRATED",
    "MAX_ITERATIONS",
    "PASSIVE_SHARE",
    "TORQUE_SHARE",
    "UNLIMITED",
    "Disturbance",
    "MarginalLikelihood",
    "Measurement",
    "Policies",
    "Tolerated",
    "body_unit",
    "converge_motion",
    "descend",
    "describe_smoothing_velocity",
    "design_rows",
    "disturbance_levels",
    "disturbance_likelihood",
    "faults",
    "find_disturbance",
    "find_loop",
    "fit",
    "fit_admissible",
    "fit_each",
    "fit_nominal",
    "free_mask",
    "gentle_start",
    "has_torque",
    "imu_levels",
    "iterate",
    "known_noise",
    "limit_met",
    "mistaken_torques",
    "next_measurement",
    "noise_floors",
    "of_noise",
    "require_scale",
    "start_motion",
    "start_state",
    "tolerated",
    "torque_levels",
    "weighted_least_squares",
    "with_second_opinion",
]
