"""Effects that a simulation of the leg can get wrong: one file with one class an effect."""

from estimator.effects.backlash import Backlash
from estimator.effects.base import (
    WHEEL_M,
    Axis,
    BodyEffect,
    Effect,
    LawEffect,
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
from estimator.effects.command_delay import CommandDelay
from estimator.effects.commanded import Commanded, Told
from estimator.effects.derivatives import FEATURES, Around, Laws, by_motion
from estimator.effects.encoder_offset import EncoderOffset
from estimator.effects.gear_effect import GearEffect
from estimator.effects.generic_terms import GenericReading, GenericTorque, battery
from estimator.effects.loop_effect import ClosedLoop
from estimator.effects.loop_integral import RecordedMotion, SimulatedIntegral, summed
from estimator.effects.loop_values import DampingValue, LimitValue, VelocityFilter
from estimator.effects.missing_integral import MissingIntegral
from estimator.effects.registry import ENTRY_POINT, UNTESTABLE, classes, library, named, placed
from estimator.effects.sensor_effects import EncoderEffect, ImuEffect
from estimator.effects.sensor_time_skew import SensorTimeSkew
from estimator.effects.state_torque import StateTorque, Table, Variable
from estimator.effects.stribeck_friction import StribeckFriction
from estimator.effects.torque_delay import TorqueDelay

__all__ = [
    "ENTRY_POINT",
    "FEATURES",
    "UNTESTABLE",
    "WHEEL_M",
    "Around",
    "Axis",
    "Backlash",
    "BodyEffect",
    "ClosedLoop",
    "CommandDelay",
    "Commanded",
    "DampingValue",
    "Effect",
    "EncoderEffect",
    "EncoderOffset",
    "GearEffect",
    "GenericReading",
    "GenericTorque",
    "ImuEffect",
    "LawEffect",
    "Laws",
    "LimitValue",
    "MissingIntegral",
    "Perturbation",
    "PlanKind",
    "Points",
    "Record",
    "RecordedMotion",
    "SensorEffect",
    "SensorTimeSkew",
    "Shape",
    "SimulatedIntegral",
    "Size",
    "StateEffect",
    "StateTorque",
    "StribeckFriction",
    "Table",
    "Told",
    "TorqueDelay",
    "TorqueEffect",
    "Variable",
    "VelocityFilter",
    "View",
    "battery",
    "by_motion",
    "classes",
    "library",
    "named",
    "placed",
    "summed",
]
