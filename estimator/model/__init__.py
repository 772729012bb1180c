"""Planar trees: regressor, inertia, bias torque, collocation of one motion, forward simulation."""

from estimator.model.bodies import (
    body_values,
    carried,
    formula,
    has_bodies,
    parent_of,
    rigid_parameters,
)
from estimator.model.chain import chain
from estimator.model.collocation import (
    GAUSS,
    HELD,
    HOLDS,
    PAST,
    STEPPED,
    TICKS,
    Collocation,
    Samples,
    after,
    curves,
    lag,
    ticks_of,
)
from estimator.model.forward_simulation import simulate
from estimator.model.impact import land
from estimator.model.mechanism import VELOCITY_SCALE, ImuPlace, Mechanism, Parameter, biped3, joint1, leg2
from estimator.model.registry import builders, joint_counts, settings_of
from estimator.model.regressor_numba import invert
from estimator.model.terms import ACCEL, ANGLE, RATE, RATE_FROM, RATE_TO, Motion, mean_sign, smooth_sign

__all__ = [
    "ACCEL", "ANGLE", "GAUSS", "HELD", "HOLDS", "PAST", "RATE", "RATE_FROM", "RATE_TO", "STEPPED", "TICKS",
    "VELOCITY_SCALE", "Collocation", "ImuPlace", "Mechanism", "Motion", "Parameter", "Samples", "after", "biped3",
    "body_values", "builders", "carried", "chain", "curves", "formula", "has_bodies", "invert", "joint1",
    "joint_counts", "lag", "land", "leg2", "mean_sign", "parent_of", "rigid_parameters", "settings_of",
    "simulate", "smooth_sign", "ticks_of",
]
