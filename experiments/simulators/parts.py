"""`parts_of`: an identified model as the parts of a simulator's model, and the effects that are left for a program.

A part is what MuJoCo's elements hold: mass, spring, damping, dry friction, stop, cogging, bristles, delay. An effect
becomes parts, or it is `left`: then the generated module applies its law around a step.
"""

from __future__ import annotations

import math
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
    for effect in model.effects:
        if effect.name in OF_LOOP:
            parts.notes.append(f"{effect.name} is of the position loop: the export takes the torque that acts")
            continue
        if effect.shapes.get("heard_by_loop") == 0.0:
            parts.notes.append(f"{effect.name} is of the log alone: a loop takes the joint's angle, not the encoder's")
        if not _hold(parts, effect, where):
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


def _hold(parts: Parts, effect: EffectValue, where: str) -> bool:
    """Make parts of an effect. Returns whether nothing of it is left; raises `InputError` for one that is not ours."""
    size, shape, j = effect.sizes, effect.shapes, (effect.joint or 1) - 1
    joint, joints = parts.joints[j], [parts.joints[k] for k in ([j] if effect.joint else parts.mechanism.actuated)]
    match effect.name:
        case "joint_stiffness":
            joint.stiffness += size["stiffness"]
            joint.preload += size["preload"]
        case "quadratic_drag":
            joint.drag += max(size["drag"], 0.0)
            return size["drag"] >= 0.0
        case "rotor_inertia":
            joint.armature += size["inertia"]
        case "joint_elasticity" | "backlash":  # what the gear twists is left
            joint.viscous += size["motor_viscous"]
            joint.coulomb += size["motor_coulomb"]
            joint.armature += size["motor_inertia"]
            return False
        case "torque_offset":
            for one in joints:
                one.offset += size["offset"]
        case "torque_delay":
            for one in joints:
                one.delay_s = max(-size["delay"], 0.0)
            return size["delay"] <= 0.0
        case "sensor_time_skew":
            parts.imu_delay_s = max(size["skew"], 0.0)
            return size["skew"] >= 0.0
        case "asymmetric_friction":
            # F (1 + s) / 2 + B (1 + s) / 2 v: half of F is a constant, half Coulomb friction; B |v| / 2 is left
            half, slope = 0.5 * size["coulomb_difference"], 0.5 * size["viscous_difference"]
            joint.coulomb += half
            joint.preload -= half
            joint.viscous += slope
            return slope == 0.0
        case "end_stop_contact":
            share = shape["angle_share"]
            joint.stops.append((size["stiffness"], share * abs(parts.model.reach[j][1 if share > 0 else 0])))
        case "torque_ripple":
            sine, cosine = size["sine_amplitude"], size["cosine_amplitude"]
            order = shape["order"] * parts.model.gear_ratio
            joint.ripples.append((math.hypot(sine, cosine), order, math.atan2(cosine, sine)))
        case "presliding_friction":
            joint.bristles.append((size["level"], size["bristle_damping"], shape["displacement"]))
        case "base_compliance":
            if size["mobility"] > 0.0:
                mass, omega = 1.0 / size["mobility"], 2.0 * math.pi * shape["frequency"]
                parts.stand = Stand(mass, mass * omega**2, 2.0 * shape["damping_ratio"] * omega * mass)
        case "imu_lever_arm":
            parts.imu_excess_m += size["excess"]
        case "imu_misalignment":
            parts.imu_turn_rad += size["angle"]
        case "encoder_scale":
            joint.scale += size["scale_error"]
        case name if name in LEVELS:
            joint.further_level += abs(next(iter(size.values())))
            return False
        case name if name in LEFT:
            return False
        case _:
            raise InputError(where, f"has the effect {effect.name}, whose law is in a package of yours: no export "
                             "knows it", REMEDY)
    return True


LEVELS = ("stribeck_friction", "friction_drift", "load_dependent_friction", "load_stribeck_friction",
          "quadratic_load_friction", "directional_load_friction")
"""Effects that change a joint's dry friction as it moves."""
LEFT = ("torque_saturation", "gyro_bias", "gyro_scale", "accelerometer_bias", "encoder_offset", "encoder_eccentricity")
"""Effects of which no part holds anything."""
OF_LOOP = ("command_delay", "gain_scale", "missing_integral", "input_limit", "supply_sag", "command_dead_band",
           "command_steps")
"""Effects of what makes the torque, which an export is given."""
