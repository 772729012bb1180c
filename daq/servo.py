"""`[servo]` of rig.toml: the law by which a servo makes torque of the position that it is commanded."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Gain = Annotated[float, Meta(gt=0, le=1e6)]
Damping = Annotated[float, Meta(ge=0, le=1e6)]


class Servo(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """torque = gain * (q_cmd - q) - damping * qd within +-limit, of every driven joint without a torque column.

    A list has one number for each driven joint, by rising joint. With `input = "voltage"` the law gives duty, in
    place of a column of that name.
    """

    gain: Gain | tuple[Gain, ...] | None = None
    """[N m/rad], of duty [1/rad]; None: a fit finds it from one parameter that is given, the same at all joints"""
    damping: Damping | tuple[Damping, ...] = 0.0
    """[N m s/rad], of duty [s/rad]"""
    limit: Gain | tuple[Gain, ...] | None = None
    """[N m], of duty at most 1; None: the servo has enough"""


def faults(servo: Servo, driven: int) -> tuple[str, str] | None:
    """Faults of a table for so many driven joints, and the remedy; None without a fault."""
    for name in servo.__struct_fields__:
        values = getattr(servo, name)
        if isinstance(values, tuple) and len(values) != driven:
            return (f"servo.{name} has {len(values)} numbers, mechanism.actuated {driven} driven joints",
                    "give one number for all driven joints, or one for each by rising joint")
    if servo.gain is None and (servo.damping != 0.0 or servo.limit is not None):
        return "servo.damping and servo.limit say nothing without a gain", "give servo.gain, or take them out"
    return None
