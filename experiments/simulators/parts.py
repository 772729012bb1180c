"""`parts_of`: an identified model as the parts of a simulator's model, and the effects that are left for a program.

A part is what MuJoCo's elements hold: mass, spring, damping, dry friction, stop, cogging, bristles, delay. An effect
becomes parts, or it is `left`: then the generated module applies its law around a step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from daq import FloatArray, InputError
from estimator.model import Mechanism
from experiments.models import EffectValue, Model, build_mechanism
from experiments.simulators.bodies import Body, bodies_of

REMEDY = "take it out of `effects` of the model file, and simulate the rest"


@dataclass
class JointParts:
    """Torques on one joint, and the errors of its readings. SI units; a slide has N for N m and m for rad."""

    name: str
    driven: bool
    viscous: float
    coulomb: float
    smoothing: float
    """Speed over which the sign of the velocity is smoothed [rad/s]."""
    armature: float
    offset: float = 0.0
    """How much the measured torque reads above the one that acts."""
    drag: float = 0.0
    """c of c v |v|."""
    stiffness: float = 0.0
    preload: float = 0.0
    """The joint takes the torque stiffness q - preload."""
    stops: list[tuple[float, float]] = field(default_factory=list)
    """Stiffness and angle of one-sided springs; the angle's sign is the side."""
    ripples: list[tuple[float, float, float]] = field(default_factory=list)
    """(A, n, phase) of the torque A sin(n q + phase)."""
    bristles: list[tuple[float, float, float]] = field(default_factory=list)
    """(level, damping, displacement) of LuGre bristles in place of part of the Coulomb friction."""
    delay_s: float = 0.0
    """How late the measured torque acts."""
    scale: float = 1.0
    """Of the encoder's reading."""
    further_level: float = 0.0
    """Dry friction near rest by effects that are left [N m]: how stiff friction may become."""

    @property
    def dry(self) -> float:
        """Coulomb friction, what bristles take of it included [N m]."""
        return self.coulomb + sum(level for level, *_ in self.bristles)


@dataclass(frozen=True)
class Stand:
    """A body that slides under the pivot on a spring."""

    mass: float
    """Of everything that slides, the leg's bodies included [kg]"""
    stiffness: float
    damping: float


@dataclass
class Parts:
    """One model's parts. `left` are its effects that no part holds."""

    model: Model
    mechanism: Mechanism
    bodies: list[Body]
    joints: list[JointParts]
    stand: Stand | None = None
    imu_excess_m: float = 0.0
    """How much farther out the first IMU sits than declared."""
    imu_turn_rad: float = 0.0
    """How far it is turned in the sense of q1."""
    imu_delay_s: float = 0.0
    left: list[EffectValue] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def inverse_inertia(self) -> FloatArray:
        """(n,) diagonal of the inverse inertia matrix at zero angles [1/(kg m^2)]: MuJoCo's `dof_invweight0`."""
        inertia = self.mechanism.inertia_matrix(np.zeros(len(self.joints)), np.array(self.model.beta))
        inertia = inertia + np.diag([joint.armature - body.rotor for joint, body in zip(self.joints, self.bodies)])
        if self.stand is not None:
            moments = [sum(value for p, value in zip(self.mechanism.parameters, self.model.beta)
                           if (p.term, p.at) == ("gravity", (i,))) for i in range(len(self.joints))]
            whole = np.full((len(inertia) + 1,) * 2, self.stand.mass)
            whole[1:, 1:], whole[0, 1:] = inertia, np.array(moments) @ self.mechanism.transform
            whole[1:, 0] = whole[0, 1:]
            return np.diag(np.linalg.inv(whole))[1:]
        return np.asarray(np.diag(np.linalg.inv(inertia)))


def parts_of(model: Model, where: str) -> Parts:
    """Parts of a model of one or two links. Raises `InputError` naming what no simulator's model can hold."""
    mechanism, bodies = build_mechanism(model.mechanism), bodies_of(model, where)
    speeds = mechanism.velocity_scales
    joints = [JointParts(b.joint, b.driven, b.viscous, b.coulomb, float(speed), b.rotor, b.offset)
              for b, speed in zip(bodies, speeds)]
    parts = Parts(model, mechanism, bodies, joints)
    driven = mechanism.actuated
    for effect in model.effects:
        if effect.name in OF_LOOP:
            parts.notes.append(f"{effect.name} is of the position loop: the export takes the torque that acts")
            continue
        if effect.shapes.get("heard_by_loop") == 0.0:
            parts.notes.append(f"{effect.name} is of the log alone: a loop takes the joint's angle, not the encoder's")
        if effect.name not in (*ADDED, *HELD, *LEFT):
            raise InputError(where, f"has the effect {effect.name}, whose law is in a package of yours: no export "
                             "knows it", REMEDY)
        at = [effect.joint - 1] if effect.joint else list(driven)
        own = [joints[j] for j in at]
        for part, size in ADDED.get(effect.name, {}).items():
            for joint in own:
                setattr(joint, part, getattr(joint, part) + effect.sizes[size])
        if effect.name in LEFT or (effect.name in HELD and not HELD[effect.name](parts, effect, own, at)):
            parts.left.append(effect)
    _rest(parts, where)
    return parts


def _rest(parts: Parts, where: str) -> None:
    """What no passive element can have: negative coefficients are a fit's errors, or no machine."""
    for joint in parts.joints:
        for what, name in (("viscous friction", "viscous"), ("Coulomb friction", "coulomb"),
                           ("rotor inertia", "armature")):
            value = getattr(joint, name)
            if value < 0:
                parts.notes.append(f"{what} of {joint.name} is {value:g}, a fit's error: written as 0")
                setattr(joint, name, 0.0)
        bent = sum(level for level, *_ in joint.bristles)
        if bent > joint.coulomb:
            raise InputError(where, f"has presliding_friction of {bent:g} N m at {joint.name}, more than the Coulomb "
                             f"friction of {joint.coulomb:g} that it replaces", "fit on runs with longer slides, or "
                             + REMEDY)
        joint.coulomb -= bent
    if parts.stand is not None:
        least = sum(body.mass for body in parts.bodies)
        if parts.stand.mass <= least:
            raise InputError(where, f"has base_compliance with a mass of {parts.stand.mass:.3g} kg in all, and the leg "
                             f"alone has {least:.3g}", REMEDY)


Hold = Callable[[Parts, EffectValue, "list[JointParts]", "list[int]"], bool]


def _drag(parts: Parts, effect: EffectValue, joints: list[JointParts], at: list[int]) -> bool:
    joints[0].drag += max(effect.sizes["drag"], 0.0)
    return effect.sizes["drag"] >= 0.0


def _delay(parts: Parts, effect: EffectValue, joints: list[JointParts], at: list[int]) -> bool:
    late = -effect.sizes["delay"]
    for joint in joints:
        joint.delay_s = max(late, 0.0)
    return late >= 0.0


def _skew(parts: Parts, effect: EffectValue, joints: list[JointParts], at: list[int]) -> bool:
    parts.imu_delay_s = max(effect.sizes["skew"], 0.0)
    return effect.sizes["skew"] >= 0.0


def _asymmetric(parts: Parts, effect: EffectValue, joints: list[JointParts], at: list[int]) -> bool:
    """F (1 + s) / 2 + B (1 + s) / 2 v: half of F is a constant, half Coulomb friction; B |v| / 2 is left."""
    half, slope = 0.5 * effect.sizes["coulomb_difference"], 0.5 * effect.sizes["viscous_difference"]
    joints[0].coulomb += half
    joints[0].preload -= half
    joints[0].viscous += slope
    return slope == 0.0


def _stop(parts: Parts, effect: EffectValue, joints: list[JointParts], at: list[int]) -> bool:
    share, side = effect.shapes["angle_share"], effect.shapes["angle_share"] > 0
    reach = abs(parts.model.reach[at[0]][1 if side else 0])
    joints[0].stops.append((effect.sizes["stiffness"], share * reach))
    return True


def _ripple(parts: Parts, effect: EffectValue, joints: list[JointParts], at: list[int]) -> bool:
    sine, cosine = effect.sizes["sine_amplitude"], effect.sizes["cosine_amplitude"]
    order = effect.shapes["order"] * parts.model.gear_ratio
    joints[0].ripples.append((math.hypot(sine, cosine), order, math.atan2(cosine, sine)))
    return True


def _bristles(parts: Parts, effect: EffectValue, joints: list[JointParts], at: list[int]) -> bool:
    joints[0].bristles.append((effect.sizes["level"], effect.sizes["bristle_damping"], effect.shapes["displacement"]))
    return True


def _stand(parts: Parts, effect: EffectValue, joints: list[JointParts], at: list[int]) -> bool:
    if effect.sizes["mobility"] > 0.0:
        mass, omega = 1.0 / effect.sizes["mobility"], 2.0 * math.pi * effect.shapes["frequency"]
        parts.stand = Stand(mass, mass * omega**2, 2.0 * effect.shapes["damping_ratio"] * omega * mass)
    return True


def _lever(parts: Parts, effect: EffectValue, joints: list[JointParts], at: list[int]) -> bool:
    parts.imu_excess_m += effect.sizes["excess"]
    return True


def _turn(parts: Parts, effect: EffectValue, joints: list[JointParts], at: list[int]) -> bool:
    parts.imu_turn_rad += effect.sizes["angle"]
    return True


def _levels(parts: Parts, effect: EffectValue, joints: list[JointParts], at: list[int]) -> bool:
    joints[0].further_level += abs(next(iter(effect.sizes.values())))
    return False


MOTOR_SIDE = {"viscous": "motor_viscous", "coulomb": "motor_coulomb", "armature": "motor_inertia"}
ADDED: dict[str, dict[str, str]] = {
    "joint_stiffness": {"stiffness": "stiffness", "preload": "preload"}, "rotor_inertia": {"armature": "inertia"},
    "joint_elasticity": MOTOR_SIDE, "backlash": MOTOR_SIDE, "torque_offset": {"offset": "offset"},
    "encoder_scale": {"scale": "scale_error"}}
"""Effect to the number of a joint's parts that each of its sizes is added to."""
HELD: dict[str, Hold] = {
    "quadratic_drag": _drag, "torque_delay": _delay, "sensor_time_skew": _skew, "asymmetric_friction": _asymmetric,
    "end_stop_contact": _stop, "torque_ripple": _ripple, "presliding_friction": _bristles, "base_compliance": _stand,
    "imu_lever_arm": _lever, "imu_misalignment": _turn, "stribeck_friction": _levels, "friction_drift": _levels,
    "load_dependent_friction": _levels, "load_stribeck_friction": _levels, "quadratic_load_friction": _levels,
    "directional_load_friction": _levels}
"""Effect to what makes parts of it; that returns whether nothing is left of it."""
LEFT = ("joint_elasticity", "backlash", "torque_saturation", "gyro_bias", "gyro_scale", "accelerometer_bias",
        "encoder_offset", "encoder_eccentricity")
"""Effects that the module applies whatever the parts hold of them: a gear's twist, errors of readings."""
OF_LOOP = ("command_delay", "gain_scale", "missing_integral", "input_limit", "supply_sag", "command_dead_band",
           "command_steps")
"""Effects of what makes the torque, which an export is given."""
