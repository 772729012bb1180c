"""The estimators mle, mle-free, wls, rls and hekf, their starts, their bounds, their validation."""

from estimator.fitting.fit import fit, likely_hold
from estimator.fitting.fit_each import fit_each
from estimator.fitting.gauss_newton import MAX_ITERATIONS, PASSIVE_SHARE, TORQUE_SHARE, iterate, mistakes_torque
from estimator.fitting.initial_guess import gentle_start, noise_floors, start_state
from estimator.fitting.profile_likelihood import known_noise
from estimator.fitting.validation import Validation, validate
from estimator.fitting.wls import design_rows, free_mask, weighted_least_squares

__all__ = [
    "MAX_ITERATIONS", "PASSIVE_SHARE", "TORQUE_SHARE", "Validation", "design_rows", "fit", "fit_each", "free_mask",
    "gentle_start", "iterate", "known_noise", "likely_hold", "mistakes_torque", "noise_floors", "start_state",
    "validate", "weighted_least_squares"
]
