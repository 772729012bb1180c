"""Effects that a simulation of the leg can get wrong: one small class an effect."""

from estimator.effects.base import (
    Axis,
    BodyEffect,
    Effect,
    Perturbation,
    PlanKind,
    Points,
    Record,
    SensorEffect,
    Shape,
    Size,
    StateEffect,
    TorqueEffect,
    View,
)
from estimator.effects.derivatives import Laws, by_motion
from estimator.effects.generic_terms import GenericReading, GenericTorque, battery
from estimator.effects.registry import ENTRY_POINT, UNTESTABLE, classes, library, placed
from estimator.effects.sensors import EncoderOffset
from estimator.effects.state_torque import StateTorque, Table, Variable
from estimator.effects.timing import SensorTimeSkew

__all__ = [
    "ENTRY_POINT",
    "UNTESTABLE",
    "Axis",
    "BodyEffect",
    "Effect",
    "EncoderOffset",
    "GenericReading",
    "GenericTorque",
    "Laws",
    "Perturbation",
    "PlanKind",
    "Points",
    "Record",
    "SensorEffect",
    "SensorTimeSkew",
    "Shape",
    "Size",
    "StateEffect",
    "StateTorque",
    "Table",
    "TorqueEffect",
    "Variable",
    "View",
    "battery",
    "by_motion",
    "classes",
    "library",
    "placed"
]
