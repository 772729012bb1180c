"""What a simulation of the leg can get wrong: one small class an effect."""

from estimator.effects.base import (
    MOTOR_ACCELERATION,
    MOTOR_RATE,
    SLOW_GYRO,
    SLOW_TORQUE,
    Effect,
    Perturbation,
    Points,
    SensorEffect,
    Shape,
    Size,
    TorqueEffect,
    View,
)
from estimator.effects.derivatives import Laws, by_motion
from estimator.effects.generic_terms import AnonymousReading, AnonymousTorque, battery
from estimator.effects.registry import CLASSES, ENTRY_POINT, UNTESTABLE, classes, library
from estimator.effects.timing import SensorTimeSkew

__all__ = [
    "CLASSES", "ENTRY_POINT", "MOTOR_ACCELERATION", "MOTOR_RATE", "SLOW_GYRO", "SLOW_TORQUE", "UNTESTABLE",
    "AnonymousReading", "AnonymousTorque", "Effect", "Laws", "Perturbation", "Points", "SensorEffect",
    "SensorTimeSkew", "Shape", "Size", "TorqueEffect", "View", "battery", "by_motion", "classes", "library"
]
