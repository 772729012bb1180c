"""`[servo]` of rig.toml: the law by which a servo makes torque of the position that it is commanded."""

from __future__ import annotations

import math
from typing import Annotated

from msgspec import Meta, Struct

from daq.loop import Loop

Gain = Annotated[float, Meta(gt=0, le=1e6)]
Share = Annotated[float, Meta(ge=0, le=1e6)]
Delay = Annotated[float, Meta(ge=-1, le=1)]
Lag = Annotated[float, Meta(ge=0, le=1)]
LATENESS, SCALE, LAG = "command_delay", "torque_gain", "velocity_filter"
"""Effects that the tolerances of a delay, of a gain and of a filter of the rate are of."""


class ServoTolerance(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[servo.tolerance]`: standard deviation of what is stated, in its unit."""

    gain: Share = 0.0
    delay_s: Share = 0.0
    command_filter_s: Share = 0.0
    velocity_filter_s: Share = 0.0


class Servo(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The position loop of every driven joint without a torque column; see `Loop` for the law.

    A list has one number for each driven joint, by rising joint. With `input = "voltage"`, or with a motor's
    resistance and torque constant, gain, damping, integral and limit are of duty.
    """

    gain: Gain | tuple[Gain, ...] | None = None
    """[N m/rad], of duty [1/rad]; None: a fit finds it from one parameter that is given, the same at all joints"""
    damping: Share | tuple[Share, ...] | None = None
    """[N m s/rad], of duty [s/rad]; None: a fit estimates it where the runs show it"""
    integral: Share | tuple[Share, ...] | None = None
    """[N m/(rad s)], of duty [1/(rad s)]; it begins at zero with every run; None: as with the damping"""
    feedforward: Annotated[float, Meta(ge=0, le=2)] = 0.0
    """Share of the commanded rate in what the damping acts on"""
    limit: Gain | tuple[Gain, ...] | None = None
    """[N m], of duty at most 1; None: as with the damping"""
    delay_s: Delay | None = None
    """How late a command acts; None: a fit estimates it"""
    velocity_filter_s: Lag = 0.0
    """Time constant of the low pass of first order behind which the damping has the measured rate (SimpleFOC:
    LPF_velocity.Tf)"""
    command_filter_s: Lag = 0.0
    """The same of the command and its rate"""
    rate_hz: Annotated[float, Meta(gt=0, le=1e6)] | None = None
    """Of the loop, which holds its torque from tick to tick; None: fast"""
    supply_v: Gain | None = None
    """Of a motor, where no column `supply_v` or `volts` has it"""
    resistance_ohm: Gain | None = None
    torque_constant_nm_per_a: Gain | None = None
    """At the joint, gear included; also the back-EMF [V s/rad]"""
    current_a: Gain | None = None
    """Largest current of the motor"""
    tolerance: ServoTolerance = ServoTolerance()

    def loop(self, at: int, voltage: bool) -> Loop:
        """The loop of driven joint number `at`, from 0; with a gain of 1 where it is not known. `voltage`: the
        mechanism is driven by volts."""
        gain, damping, integral, limit = (value[at] if isinstance(value, tuple) else value for value in (
            self.gain, self.damping, self.integral, self.limit))
        motor = self.resistance_ohm is not None and self.torque_constant_nm_per_a is not None
        k, r = self.torque_constant_nm_per_a or 1.0, self.resistance_ohm or 1.0
        supply = 1.0 if not (motor or voltage) else math.nan if self.supply_v is None else self.supply_v
        most = 1.0 if limit is None and (motor or voltage) and gain is not None else limit
        return Loop(1.0 if gain is None else gain, damping or 0.0, integral or 0.0, self.feedforward,
                    math.inf if most is None or gain is None else most, self.delay_s or 0.0,
                    0.0 if self.rate_hz is None else 1.0 / self.rate_hz, supply, k / r if motor else 1.0,
                    k * k / r if motor else 0.0, self.velocity_filter_s, self.command_filter_s,
                    k * self.current_a if motor and self.current_a else math.inf)

    @property
    def tolerances(self) -> dict[str, tuple[float, ...]]:
        """Effect to the tolerance of its size."""
        gains = self.gain if isinstance(self.gain, tuple) else (self.gain,)
        found: dict[str, tuple[float, ...]] = {}
        late = math.hypot(self.tolerance.delay_s, self.tolerance.command_filter_s)  # a slow filter is a delay
        if late:
            found[LATENESS] = (late,)
        if self.tolerance.velocity_filter_s:
            found[LAG] = (self.tolerance.velocity_filter_s,)
        if self.tolerance.gain and gains[0]:
            found[SCALE] = (self.tolerance.gain / gains[0],)
        return found


def faults(servo: Servo, driven: int, voltage: bool) -> tuple[str, str] | None:
    """Faults of a table for so many driven joints, and the remedy; None without a fault. `voltage` as in `loop`."""
    for name in servo.__struct_fields__:
        values = getattr(servo, name)
        if isinstance(values, tuple) and len(values) != driven:
            return (f"servo.{name} has {len(values)} numbers, mechanism.actuated {driven} driven joints",
                    "give one number for all driven joints, or one for each by rising joint")
    needs_gain = [name for name in ("damping", "integral", "limit", "resistance_ohm") if getattr(servo, name)]
    if servo.gain is None and needs_gain:
        return f"servo.{needs_gain[0]} says nothing without servo.gain", "give servo.gain, or take it out"
    if servo.resistance_ohm is not None and voltage:
        return ("servo.resistance_ohm makes a torque of the duty, and mechanism.input is a voltage",
                'take out resistance_ohm and torque_constant_nm_per_a, or input = "voltage"')
    if (servo.resistance_ohm is None) != (servo.torque_constant_nm_per_a is None):
        return ("servo has one of resistance_ohm and torque_constant_nm_per_a",
                "give both of the motor, or neither for a drive that makes torque")
    return None
