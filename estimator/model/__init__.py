"""Planar trees: regressor, inertia, bias torque, collocation of one motion, forward simulation."""

from estimator.model.collocation import (
    ACCEL,
    ANGLE,
    GAUSS,
    HOLDS,
    RATE,
    RATE_FROM,
    RATE_TO,
    Collocation,
    Motion,
    Samples,
    after,
    mean_sign,
)
from estimator.model.forward_simulation import simulate
from estimator.model.mechanism import VELOCITY_SCALE, Mechanism, biped3, chain, joint1, leg2, smooth_sign

__all__ = [
    "ACCEL", "ANGLE", "GAUSS", "HOLDS", "RATE", "RATE_FROM", "RATE_TO", "VELOCITY_SCALE", "Collocation", "Mechanism",
    "Motion", "Samples", "after", "biped3", "chain", "joint1", "leg2", "mean_sign", "simulate", "smooth_sign"
]
